"""Does a registration agree with its own error budget, and which sphere has moved when it does not?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.registration import Registration, drop_one_explanations, register
from procedures.registration.error_theory import FreGate

Array = NDArray[np.float64]

REPEATABILITY_MM = 0.03  # per axis: robot at rest, and the servo's tolerance
# The arm's error varies slowly with its joints: neighbours share it, far points do not, so its share of a
# residual is not that of independent points of one sigma. The gate alone allows more of it; the
# prediction and the weights of the fit keep the stated sigma. The price: with 4 spheres and a sigma of 0.1 mm
# a sphere is found to have moved (9 times of 10) from 1.2 mm on, not from 1.0; twice the sigma: from 1.8.
GATE_ARM_RESERVE = 1.5
GATE_CONFIDENCE = 0.999  # of the chi-square gate: one false alarm in a thousand registrations


def residual_gate(image_mm: Array, physical_mm: Array, measured_mm2: Array, arm_mm: float) -> FreGate:
    """Judge the residual of paired points (n, 3) mm with the reserve for the arm's shared error.

    `measured_mm2` (n, 3, 3) is the covariance of CT and stereo head, `arm_mm` the arm's sigma per axis.
    Raises REG-001 to REG-006.
    """
    return _fit_with_reserve(image_mm, physical_mm, measured_mm2, arm_mm).gate(confidence=GATE_CONFIDENCE)


def moved_spheres(image_mm: Array, physical_mm: Array, measured_mm2: Array, arm_mm: float) -> tuple[int, ...]:
    """Pairs without one of which the others pass the gate, the likeliest first; see `residual_gate`."""
    fit = _fit_with_reserve(image_mm, physical_mm, measured_mm2, arm_mm)
    return drop_one_explanations(fit, confidence=GATE_CONFIDENCE)


def _fit_with_reserve(
    image_mm: Array, physical_mm: Array, measured_mm2: Array, arm_mm: float
) -> Registration:
    allowed = measured_mm2 + arm_covariance_mm2(GATE_ARM_RESERVE * arm_mm)
    return register(image_mm, physical_mm, covariance_mm2=allowed)


def arm_covariance_mm2(arm_mm: float) -> Array:
    """(3, 3) mm2 of one point at rest, from the arm's sigma per axis."""
    return np.asarray(np.eye(3) * (arm_mm**2 + REPEATABILITY_MM**2))
