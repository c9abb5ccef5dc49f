"""Error to expect at a target, from errors that localizations and target share and from those of their own.

An error of the arm (a link too long, a tool frame out of place) displaces the tool at every sphere and again
at the target. What the registration recorded is wrong by the first, what the arm then reaches by the second,
and with the registration in between the two subtract:

    error at the target = (J_t - sum_i W_i J_i) s  +  e_t  -  sum_i W_i e_i

s: sizes of the shared errors, J: displacement of the tool by each at target (t) and sphere (i), e: errors of
their own, W: what the fit makes of a recorded sphere at the target. To first order in all errors, as the
covariances of Danilchenko and Fitzpatrick 2011.

Nothing here knows an arm; `procedures.calibration.arm_sources` gives the displacements of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.registration.error_theory import DEFAULT_CONFIDENCE, chi_square_limit, error_limit_mm
from procedures.registration.weighted_rigid_fit import pose_jacobian

Array = NDArray[np.float64]

AXES = 3


@dataclass(frozen=True)
class SharedErrors:
    """`k` independent errors of one source that act at all poses, one standard deviation each.

    How far they displace the true tool from where it is believed, mm in the frame of the targets.
    """

    source: str
    at_spheres_mm: Array  # (n, 3, k)
    at_target_mm: Array  # (3, k)


@dataclass(frozen=True)
class OwnErrors:
    """Errors of one source that are independent from pose to pose: covariances, mm2."""

    source: str
    at_spheres_mm2: Array  # (n, 3, 3) of a recorded sphere
    at_target_mm2: Array  # (3, 3) of the tool at the target


@dataclass(frozen=True)
class TargetPrediction:
    """Covariance (3, 3) mm2 of the error at one target, by source; the sources are independent."""

    by_source_mm2: dict[str, Array]

    @property
    def covariance_mm2(self) -> Array:
        """Of the whole error."""
        return np.asarray(np.sum(list(self.by_source_mm2.values()), axis=0))

    @property
    def rms_mm(self) -> float:
        """Root mean square of the error's length."""
        return float(np.sqrt(np.trace(self.covariance_mm2)))

    @property
    def budget_mm(self) -> dict[str, float]:
        """Share of each source, rms; the squares add up to the square of the whole."""
        return {name: float(np.sqrt(np.trace(part))) for name, part in self.by_source_mm2.items()}

    def limit_mm(self, confidence: float = DEFAULT_CONFIDENCE) -> float:
        """Radius that holds the error with this probability. Raises REG-007."""
        return float(error_limit_mm(self.covariance_mm2, confidence))

    def holds(self, errors_mm: ArrayLike, confidence: float = DEFAULT_CONFIDENCE) -> NDArray[np.bool_]:
        """Which errors (..., 3) lie inside the ellipsoid that holds them with this probability."""
        errors = np.asarray(errors_mm, dtype=float)
        weighted = np.linalg.solve(self.covariance_mm2, errors.reshape(-1, AXES).T).T.reshape(errors.shape)
        return np.asarray((errors * weighted).sum(axis=-1) <= chi_square_limit(AXES, confidence))


def predict_target_error(
    spheres_mm: ArrayLike,
    target_mm: ArrayLike,
    sources: Sequence[SharedErrors | OwnErrors],
    weights: ArrayLike | None = None,
) -> TargetPrediction:
    """Predict the error at a target (3,) mm that was registered by spheres (n, 3) mm, in one frame.

    `weights` (n, 3, 3) are those of the fit, the inverse covariances of the pairs; None is a fit without.
    """
    spheres, target = np.asarray(spheres_mm, dtype=float), np.asarray(target_mm, dtype=float)
    influence = influence_of_spheres(spheres, target, weights)
    parts: dict[str, Array] = {}
    for one in sources:
        if isinstance(one, SharedErrors):
            shift = one.at_target_mm - np.einsum("nij,njk->ik", influence, one.at_spheres_mm)
            part = shift @ shift.T
        else:
            turned = influence @ one.at_spheres_mm2 @ influence.transpose(0, 2, 1)
            part = one.at_target_mm2 + turned.sum(axis=0)
        parts[one.source] = parts.get(one.source, np.zeros((AXES, AXES))) + part
    return TargetPrediction(parts)


def influence_of_spheres(spheres_mm: Array, target_mm: Array, weights: ArrayLike | None = None) -> Array:
    """Shift (n, 3, 3) of the mapped target per shift of each recorded sphere; all of them add up to 1."""
    centre = spheres_mm.mean(axis=0)
    jacobian = pose_jacobian(spheres_mm, centre)
    projected = np.swapaxes(jacobian, -1, -2)
    if weights is not None:
        projected = projected @ np.asarray(weights, dtype=float)
    pose = np.linalg.solve((projected @ jacobian).sum(axis=0), projected)
    return np.asarray(pose_jacobian(target_mm, centre) @ pose)
