"""Deviations of the arm from measurements of stationary spheres: weighted least squares with prior set S.

The positions of the spheres are not known beforehand, so the arm's pose in the room remains undetermined, and
need not be known: a case measures its spheres with the same arm. The arm's random error is estimated from the
measurements themselves, accounting for the leverage of each in the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm.error_model import ArmModel
from procedures.calibration.arm.looks import LookArrays
from procedures.calibration.errors import DoesNotFit
from procedures.calibration.sufficiency import require_consistent, require_count, require_spread
from ronna_hw.arm.deviations import ArmDeviations
from ronna_hw.frames import Transform
from ronna_hw.text import beyond

Array = NDArray[np.float64]

LEAST_LOOKS = 60  # with fewer, validation shows errors beyond those of a calibrated arm
ROUNDS = 6  # of fit, estimate of the random error, and outlier rejection: they converge within four
FIRST_SCATTER_MM = 0.05
LEAST_SCATTER_MM = 0.003  # no arm is better
LARGEST_SCATTER_MM = 0.15  # no arm of this class is worse: something moved
OUTLIER_CHI2 = 16.3  # exceeded by 0.1 % of good measurements, with three coordinates
MOST_OUTLIERS = 0.1


@dataclass(frozen=True)
class ArmFit:
    """The identified arm. `covariance` (n, n) of `values`, both ordered and scaled as in `ArmModel`.

    `scatter_mm` is the random error of the arm per axis; `residuals_mm` (m, 3) in the robot frame; `used`
    (m,) marks the inliers.
    """

    model: ArmModel
    values: Array
    covariance: Array
    scatter_mm: float
    residuals_mm: Array
    used: NDArray[np.bool_]

    @property
    def deviations(self) -> ArmDeviations:
        """Deviations of the arm from its nominal chain."""
        return self.model.deviations(self.values)

    @property
    def flange_from_tool(self) -> Transform:
        """FLANGE <- TOOL of the head, as identified."""
        return self.model.tool(self.values)

    @property
    def learnt(self) -> Array:
        """Standard error of each parameter except the spheres', relative to its prior."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[: self.model.size]))

    @property
    def remaining(self) -> Array:
        """Lower triangle (k, k) of the covariance of what a record of the arm states, spheres wherever."""
        size = self.model.size
        root = self.model.to_record @ np.linalg.cholesky(self.covariance[:size, :size])
        _, upper = np.linalg.qr(root.T)
        found = np.zeros((len(root), len(root)))
        found[:, : len(upper)] = upper.T
        return found


def identify(model: ArmModel, looks: LookArrays) -> ArmFit:
    """The arm that best explains the measurements. Raises CAL-002, CAL-003, CAL-004."""
    count = len(looks.joints_rad)
    require_count(count, LEAST_LOOKS, "too few measurements to calibrate an arm")
    rotations = model.rotations(looks)
    require_spread(rotations, "the orientations of the measurements hardly vary")
    stereo = rotations @ looks.covariances_mm2 @ rotations.transpose(0, 2, 1)
    values = _start(model, looks)
    scatter, used = FIRST_SCATTER_MM, np.ones(count, dtype=bool)
    for _ in range(ROUNDS):
        whitening = whitening_of(stereo, scatter)
        slopes = model.slopes(values, looks)
        covariance, values = _step(model, looks, values, slopes, whitening, used)
        residuals = model.misses(values, looks)
        scatter = _scatter(residuals, slopes @ covariance @ slopes.transpose(0, 2, 1), stereo, used)
        whitened = np.einsum("mij,mj->mi", whitening_of(stereo, scatter), residuals)
        used = np.sum(whitened**2, axis=1) < OUTLIER_CHI2
    if scatter > LARGEST_SCATTER_MM:
        raise DoesNotFit(
            "spheres seem to move between measurements",
            limit=f"{LARGEST_SCATTER_MM:g} mm per axis",
            got=f"{beyond(scatter, LARGEST_SCATTER_MM, 2)} mm",
        )
    require_consistent(used, MOST_OUTLIERS, "looks")
    return ArmFit(model, values, covariance, scatter, residuals, used)


def whitening_of(stereo_mm2: Array, scatter_mm: float) -> Array:
    """Matrices (m, 3, 3) that whiten misses with these covariances and this random error."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(stereo_mm2 + scatter_mm**2 * np.eye(3))))


def _start(model: ArmModel, looks: LookArrays) -> Array:
    """The nominal arm, with every sphere at the centroid of its measurements."""
    values = np.zeros(model.size + 3 * looks.spheres)
    seen = model.misses(values, looks)
    places = [np.median(seen[looks.sphere == number], axis=0) for number in range(looks.spheres)]
    values[model.size :] = np.ravel(places)
    return values


def _step(
    model: ArmModel,
    looks: LookArrays,
    values: Array,
    slopes: Array,
    whitening: Array,
    used: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Covariance and parameters after one Gauss-Newton step."""
    rows = (whitening @ slopes)[used].reshape(-1, len(values))
    misses = np.einsum("mij,mj->mi", whitening, model.misses(values, looks))[used].ravel()
    prior = np.zeros(len(values))
    prior[: model.size] = 1.0
    covariance: Array = np.asarray(np.linalg.inv(rows.T @ rows + np.diag(prior)), dtype=float)
    return covariance, values - covariance @ (rows.T @ misses + prior * values)


def _scatter(residuals: Array, explained: Array, stereo: Array, used: NDArray[np.bool_]) -> float:
    """Random error of the arm per axis: the residuals in excess of image noise.

    `explained` (m, 3, 3) is the covariance of the fit at the measurements, by which it has
    shrunk the residuals.
    """
    square = np.sum(residuals**2, axis=1) - np.einsum("mii->m", stereo) + np.einsum("mii->m", explained)
    return float(max(np.sqrt(max(np.mean(square[used]) / 3.0, 0.0)), LEAST_SCATTER_MM))
