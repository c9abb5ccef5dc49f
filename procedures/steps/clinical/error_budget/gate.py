"""Does a registration agree with its own error budget, and which sphere has moved when it does not?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.registration import register
from procedures.registration.error_theory import FreGate, chi_square_limit, degrees_of_freedom
from procedures.registration.errors import CollinearPoints
from procedures.registration.point_registration import Registration
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.target_prediction import UnnoticedPoint, chi_square_of_shared, unnoticed_point

Array = NDArray[np.float64]

REPEATABILITY_MM = 0.03  # per axis: robot at rest, and the servo's tolerance
# The arm's error varies slowly with its joints: neighbours share it, far points do not, so its share of a
# residual is not that of independent points of one sigma. The gate alone allows more of it; the
# prediction and the weights of the fit keep the stated sigma. The price: with 4 spheres and a sigma of 0.1 mm
# a sphere is found to have moved (9 times of 10) from 1.2 mm on, not from 1.0; twice the sigma: from 1.8.
GATE_ARM_RESERVE = 1.5
ALIKE_MM = 1e-6  # shared displacements that differ by less are one
GATE_CONFIDENCE = 0.999  # of the chi-square gate: one false alarm in a thousand registrations
GROSS_MM = 3.0  # a sphere on its screw that is off by more is seen by eye (unconfirmed)


def residual_gate(
    image_mm: Array, physical_mm: Array, measured_mm2: Array, arm_mm: float, shared_mm: Array
) -> FreGate:
    """Judge the residual of paired points (n, 3) mm with the reserve for the arm's shared error.

    `measured_mm2` (n, 3, 3) is the covariance of CT, seating and stereo head, `arm_mm` the arm's sigma per
    axis, `shared_mm` (n, 3, k) what one standard deviation of each shared error displaces. Raises REG-001 to
    REG-006.
    """
    allowed = _allowed_mm2(measured_mm2, arm_mm)
    fit = register(image_mm, physical_mm, covariance_mm2=allowed)
    if float(np.ptp(shared_mm, axis=0).max()) < ALIKE_MM:  # the pose takes all of it
        return fit.gate(confidence=GATE_CONFIDENCE)
    mapped = np.asarray(fit.transform.apply(fit.image_mm), dtype=float)
    chi_square = chi_square_of_shared(fit.residuals_mm, mapped, allowed, shared_mm)
    limit = chi_square_limit(degrees_of_freedom(fit.pairs), GATE_CONFIDENCE)
    return FreGate(fit.fre_mm, chi_square, limit, GATE_CONFIDENCE)


def moved_spheres(
    image_mm: Array, physical_mm: Array, measured_mm2: Array, arm_mm: float, shared_mm: Array
) -> tuple[int, ...]:
    """Pairs without one of which the others pass the gate, the likeliest first; see `residual_gate`."""
    found: list[tuple[float, int]] = []
    for index in range(len(image_mm) if len(image_mm) > FEWEST_PAIRS else 0):
        keep = np.arange(len(image_mm)) != index
        try:
            gate = residual_gate(
                image_mm[keep], physical_mm[keep], measured_mm2[keep], arm_mm, shared_mm[keep]
            )
        except CollinearPoints:
            continue
        if gate.passed:
            found.append((gate.fre_mm, index))
    return tuple(index for _, index in sorted(found))


def unnoticed_sphere(
    fit: Registration,
    target_mm: Array,
    gate: FreGate,
    measured_mm2: Array,
    arm_mm: float,
    shared_mm: Array,
) -> UnnoticedPoint:
    """Find the sphere that, moved since the CT, puts a target off furthest while the `gate` still passes.

    `fit` is the registration used, `target_mm` (3,) is in its physical frame; the rest as in `residual_gate`.
    """
    return unnoticed_point(
        np.asarray(fit.transform.apply(fit.image_mm), dtype=float),
        target_mm,
        _allowed_mm2(measured_mm2, arm_mm),
        shared_mm,
        None if fit.covariance_mm2 is None else np.linalg.inv(fit.covariance_mm2),
        gate,
        GROSS_MM,
    )


def _allowed_mm2(measured_mm2: Array, arm_mm: float) -> Array:
    return measured_mm2 + arm_covariance_mm2(GATE_ARM_RESERVE * arm_mm)


def arm_covariance_mm2(arm_mm: float) -> Array:
    """(3, 3) mm2 of one point at rest, from the arm's sigma per axis."""
    return np.asarray(np.eye(3) * (arm_mm**2 + REPEATABILITY_MM**2))
