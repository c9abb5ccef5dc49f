"""Fiducial and target errors of rigid registration, with formulas numbered as in the thesis.

FLE is the 3-D rms localization error of BOTH spaces together; FRE the rms residual after the fit; TRE the
rms error at a target. FRE says nothing about TRE: use it only as a gate. Sources: Fitzpatrick, West, Maurer
1998 (eq. 36, 39); Danilchenko, Fitzpatrick 2011 (covariances); Satterthwaite 1946 (sum of unequal squares as
one scaled chi-square).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, chdtri, fdtri

from procedures.registration.errors import RESIDUAL_TOO_LARGE, TOO_FEW_POINTS, BadParameter
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.rigid_fit import pose_jacobian
from ronna_hw.arguments import show
from ronna_hw.arrays import Array
from ronna_hw.text import format_distinct

POSE_UNKNOWNS = 6
DEFAULT_CONFIDENCE = 0.95
LIMIT_STEPS = 1 << 16  # between two limits; the result is rounded up by at most one
NEGLIGIBLE = 1e-9  # share of a limit, below which rounding decides


def degrees_of_freedom(pairs: int) -> int:
    """Return the residual degrees of freedom of a rigid fit to `pairs` points, 3n - 6. Raises REG-002."""
    if pairs < FEWEST_PAIRS:
        raise TOO_FEW_POINTS(f"{pairs} pair(s) given", expected=f"at least {FEWEST_PAIRS}")
    return 3 * pairs - POSE_UNKNOWNS


def fle_from_fre_mm(fre_mm: float, pairs: int) -> float:
    """Estimate the FLE of both spaces from FRE, eq. 36: FLE^2 = n/(n-2) FRE^2. Raises REG-002, REG-007."""
    degrees_of_freedom(pairs)
    require_size("FRE", fre_mm)
    return fre_mm * math.sqrt(pairs / (pairs - 2))


def fle_of_one_space_mm(fre_mm: ArrayLike, pairs: int) -> float:
    """Estimate the FLE of one of two equally accurate spaces from one or more FREs, eq. 37 and 38.

    The squares are averaged over the registrations and halved between the two spaces. Raises REG-002,
    REG-007.
    """
    degrees_of_freedom(pairs)
    residuals_mm = np.asarray(fre_mm, dtype=float)
    if residuals_mm.size == 0 or not np.all(np.isfinite(residuals_mm) & (residuals_mm >= 0.0)):
        raise BadParameter("the FREs must be finite, not negative and at least one")
    return math.sqrt(float(np.square(residuals_mm).mean()) * pairs / (2.0 * (pairs - 2)))


def fre_limit_mm(fle_mm: float, pairs: int, confidence: float = DEFAULT_CONFIDENCE) -> float:
    """Return the FRE that a valid registration exceeds with probability 1 - confidence, in mm.

    3 n FRE^2 FLE^2 is chi-square with 3n - 6 degrees of freedom if FLE is isotropic and equal.
    """
    freedom = degrees_of_freedom(pairs)
    if not (math.isfinite(fle_mm) and fle_mm > 0.0):
        raise BadParameter("FLE must be positive and finite", got=f"{fle_mm} mm")
    return fle_mm * math.sqrt(chi_square_limit(freedom, confidence) / (3 * pairs))


def chi_square_limit(freedom: int, confidence: float, covariance_freedom: float | None = None) -> float:
    """Return the chi-square value exceeded with probability 1 - confidence. Raises REG-007.

    `covariance_freedom` is given when the size of the covariance was itself estimated from that many degrees
    of freedom; the limit then widens according to the F distribution.
    """
    _require_confidence(confidence)
    if covariance_freedom is not None:
        return float(freedom * fdtri(freedom, covariance_freedom, confidence))
    return float(chdtri(freedom, 1.0 - confidence))


def _require_confidence(confidence: float) -> None:
    if not 0.0 < confidence < 1.0:
        raise BadParameter(
            "a confidence must be between 0 and 1", got=f"{confidence}", action="Give a share: 0.95, not 95."
        )


@dataclass(frozen=True)
class FreGate:
    """Result of a chi-square gate on a residual. Passing the gate does not prove accuracy."""

    fre_mm: float
    chi_square: float
    chi_square_limit: float
    confidence: float

    @property
    def passed(self) -> bool:
        """Whether the known localization error explains the residual."""
        return self.chi_square <= self.chi_square_limit

    @property
    def limit_mm(self) -> float:
        """Largest FRE that would pass the gate."""
        if self.chi_square == 0.0:
            return math.inf
        return self.fre_mm * math.sqrt(self.chi_square_limit / self.chi_square)

    def require(self, action: str | None = None) -> None:
        """Raise REG-010 if the residual is too large, with this action or the usual one."""
        if not self.passed:
            fre, limit = format_distinct(self.fre_mm, self.limit_mm, 3)
            raise RESIDUAL_TOO_LARGE(
                "the fiducial residual is larger than the localization error explains",
                limit=f"{limit} mm at {100.0 * self.confidence:g}%",
                got=f"{fre} mm",
                action=action,
            )


def fre_gate(fre_mm: float, fle_mm: float, pairs: int, confidence: float = DEFAULT_CONFIDENCE) -> FreGate:
    """Judge an FRE against a known FLE (3-D rms, both spaces together). Raises REG-002, REG-007."""
    require_size("FRE", fre_mm)
    limit_mm = fre_limit_mm(fle_mm, pairs, confidence)
    limit = chi_square_limit(degrees_of_freedom(pairs), confidence)
    return FreGate(fre_mm, limit * (fre_mm / limit_mm) ** 2, limit, confidence)


def require_size(name: str, size_mm: float) -> None:
    """Raise REG-007 if an error size is negative or not finite."""
    try:
        is_size = math.isfinite(size_mm) and size_mm >= 0.0
    except TypeError as error:
        raise BadParameter(f"{name} is no number", expected="a length in mm", got=show(size_mm)) from error
    if not is_size:
        raise BadParameter(f"{name} must be finite and not negative", got=f"{size_mm} mm")


def tre_principal_axes_mm(points_mm: Array, fiducials_mm: Array, fle_mm: float) -> Array:
    """Predict target errors (..., m), rms mm, by eq. 39: FLE^2/n (1 + 1/3 sum_k d_k^2 / f_k^2).

    `d_k` is a target's distance from principal axis k of the fiducials, `f_k` their rms distance from it.
    Points (m, 3) and sets of fiducials (..., n, 3) in one frame.
    """
    centre = fiducials_mm.mean(axis=-2, keepdims=True)
    inside, count = fiducials_mm - centre, fiducials_mm.shape[-2]
    spread, axes = np.linalg.eigh(np.swapaxes(inside, -1, -2) @ inside)  # sums over the fiducials
    from_axes = (spread.sum(axis=-1, keepdims=True) - spread) / count
    along = np.square((points_mm - centre) @ axes)
    ratio = ((along.sum(axis=-1, keepdims=True) - along) / from_axes[..., None, :]).sum(axis=-1)
    return np.asarray(fle_mm * np.sqrt((1.0 + ratio / 3.0) / count))


def pose_covariance(fiducials_mm: Array, covariance_mm2: Array, *, weighted: bool) -> Array:
    """Return the fitted pose's covariance (6, 6) about the fiducials' centroid: rad^2, rad mm and mm^2.

    If the fit was `weighted` with the inverse covariances, this is the inverse normal matrix; for plain least
    squares, the sandwich form, valid for any fiducial error.
    """
    jacobian = pose_jacobian(fiducials_mm, fiducials_mm.mean(axis=0))
    transposed = np.swapaxes(jacobian, -1, -2)
    if weighted:
        return np.asarray(np.linalg.inv((transposed @ np.linalg.inv(covariance_mm2) @ jacobian).sum(axis=0)))
    bread = np.linalg.inv((transposed @ jacobian).sum(axis=0))
    return np.asarray(bread @ (transposed @ covariance_mm2 @ jacobian).sum(axis=0) @ bread)


def propagate(slopes: Array, covariance: Array) -> Array:
    """Return the covariances (..., n, n) of quantities that depend on values by these slopes (..., n, k)."""
    return np.asarray(slopes @ covariance @ np.swapaxes(slopes, -1, -2))


def target_covariance_mm2(points_mm: Array, fiducials_mm: Array, pose: Array) -> Array:
    """Propagate the pose covariance to mapped targets (m, 3), giving (m, 3, 3)."""
    return propagate(pose_jacobian(points_mm, fiducials_mm.mean(axis=0)), pose)


def error_limit_mm(covariance_mm2: Array, confidence: float, freedom: int | None = None) -> Array:
    """Return the radius (m,) in mm that contains the error vector with the given probability.

    The squared length is a sum of unequal squares, approximated by a scaled chi-square with the same mean and
    variance. `freedom` is given when the size of the error was itself estimated from that many residual
    degrees of freedom; the limit then widens according to the F distribution.
    """
    _require_confidence(confidence)
    variances = np.maximum(np.linalg.eigvalsh(covariance_mm2), 0.0)
    total = variances.sum(axis=-1)
    squares = np.square(variances).sum(axis=-1)
    shape = np.where(squares > 0.0, total**2 / np.where(squares > 0.0, squares, 1.0), 1.0)
    if freedom is None:
        factor = chdtri(shape, 1.0 - confidence) / shape
    else:
        factor = fdtri(shape, freedom, confidence)
    return np.asarray(np.sqrt(total * factor))


def rare_limit_mm(
    usual_mm2: Array, rare_mm2: Array, probability: float, confidence: float = DEFAULT_CONFIDENCE
) -> float:
    """Return the radius in mm that contains the error vector, one part of which is there only rarely.

    The covariance is `usual_mm2` (3, 3), and with this probability `usual_mm2 + rare_mm2`. Raises REG-007.
    """
    both_mm2 = usual_mm2 + rare_mm2
    low_mm, high_mm = (float(error_limit_mm(one, confidence)) for one in (usual_mm2, both_mm2))
    if high_mm <= low_mm * (1.0 + NEGLIGIBLE):
        return high_mm

    both, usual = _scaled_chi_square(both_mm2), _scaled_chi_square(usual_mm2)
    step_mm = (high_mm - low_mm) / (LIMIT_STEPS - 1)

    def radius_of(step: int) -> float:
        return step * step_mm + low_mm

    def share_within(step: int) -> float:
        radius_mm = radius_of(step)
        beyond = _share_beyond(*both, radius_mm), _share_beyond(*usual, radius_mm)
        return 1.0 - probability * beyond[0] - (1.0 - probability) * beyond[1]

    found = bisect_left(range(LIMIT_STEPS - 1), confidence, key=share_within)
    return high_mm if found == LIMIT_STEPS - 1 else radius_of(found)


def _scaled_chi_square(covariance_mm2: Array) -> tuple[float, float]:
    """Return total and shape of the squared length of an error vector, as in `error_limit_mm`."""
    total = float(np.trace(covariance_mm2))
    return total, total**2 / float(np.sum(covariance_mm2**2)) if total > 0.0 else 0.0


def _share_beyond(total_mm2: float, shape: float, radius_mm: float) -> float:
    """Return the probability of an error vector longer than a radius."""
    return float(chdtrc(shape, shape * radius_mm**2 / total_mm2)) if total_mm2 > 0.0 else 0.0


def offset_limit_mm(offset_mm: Array, covariance_mm2: Array, confidence: float) -> float:
    """Return the radius in mm that contains an offset (k,) of this covariance with the given probability.

    Its squared length has the mean and variance of a scaled chi-square: Patnaik 1949, The non-central
    chi-square and F-distributions and their applications.
    """
    _require_confidence(confidence)
    mean = float(offset_mm @ offset_mm + np.trace(covariance_mm2))
    variance = float(2.0 * np.sum(covariance_mm2**2) + 4.0 * offset_mm @ covariance_mm2 @ offset_mm)
    return float(np.sqrt(variance / (2.0 * mean) * chdtri(2.0 * mean**2 / variance, 1.0 - confidence)))
