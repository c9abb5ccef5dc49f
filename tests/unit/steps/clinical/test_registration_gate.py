"""The gate of the registration step: it allows for an error that poses share, not for a moved sphere."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.registration import register
from procedures.steps.clinical.registration_gate import (
    GATE_CONFIDENCE,
    REPEATABILITY_MM,
    moved_spheres,
    residual_gate,
)

ARM_MM = 0.1
MEASURED_MM2 = np.broadcast_to(np.eye(3) * 0.02**2, (8, 3, 3))
SPHERES_MM = np.array(
    [[x, y, 20.0 * np.sign(x * y * z) + z] for x in (-60, 60) for y in (-60, 60) for z in (-40, 40)]
)


def test_an_error_that_varies_slowly_over_the_arms_reach_passes() -> None:
    # A stretch of the room along y, as a gear that runs out of true makes it: 0.5 mm over the head.
    measured = SPHERES_MM * (1.0, 1.0 + 0.5 / 120.0, 1.0)
    own = np.eye(3) * (ARM_MM**2 + REPEATABILITY_MM**2)
    plain = register(SPHERES_MM, measured, covariance_mm2=MEASURED_MM2 + own)
    assert not plain.gate(confidence=GATE_CONFIDENCE).passed
    assert residual_gate(SPHERES_MM, measured, MEASURED_MM2, ARM_MM).passed


@pytest.mark.parametrize("moved", range(8))
def test_a_sphere_that_moved_by_a_millimetre_and_a_half_is_refused_and_named(moved: int) -> None:
    measured = SPHERES_MM.copy()
    measured[moved, 0] += 1.5
    assert not residual_gate(SPHERES_MM, measured, MEASURED_MM2, ARM_MM).passed
    assert moved_spheres(SPHERES_MM, measured, MEASURED_MM2, ARM_MM)[0] == moved
