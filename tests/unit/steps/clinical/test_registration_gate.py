"""The registration gate allows for an error that poses share, but not for a moved sphere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from procedures.registration import register
from procedures.steps.clinical.error_budget import (
    GATE_CONFIDENCE,
    REPEATABILITY_MM,
    moved_spheres,
    residual_gate,
)

ARM_MM = 0.1
MEASURED_MM2 = np.broadcast_to(np.eye(3) * 0.02**2, (8, 3, 3))
ALIKE = np.broadcast_to(2.0 * np.eye(3), (8, 3, 3))  # the tool frame, held alike at every sphere
SPHERES_MM = np.array(
    [[x, y, 20.0 * np.sign(x * y * z) + z] for x in (-60, 60) for y in (-60, 60) for z in (-40, 40)]
)


def test_an_error_that_varies_slowly_over_the_arms_reach_passes() -> None:
    # A stretch of the room along y, as a gear that runs out of true makes it: 0.5 mm over the head.
    measured = SPHERES_MM * (1.0, 1.0 + 0.5 / 120.0, 1.0)
    own = np.eye(3) * (ARM_MM**2 + REPEATABILITY_MM**2)
    plain = register(SPHERES_MM, measured, covariance_mm2=MEASURED_MM2 + own)
    assert not plain.gate(confidence=GATE_CONFIDENCE).passed
    assert residual_gate(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, ALIKE).passed


@pytest.mark.parametrize("moved", range(8))
def test_a_sphere_that_moved_by_a_millimetre_and_a_half_is_refused_and_named(moved: int) -> None:
    measured = SPHERES_MM.copy()
    measured[moved, 0] += 1.5
    assert not residual_gate(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, ALIKE).passed
    assert moved_spheres(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, ALIKE)[0] == moved


def turned_tool() -> Rotation:
    """The tool at each sphere, turned by about 8 degrees, as where the joints are to move least."""
    return Rotation.from_rotvec(np.radians(5.0) * SPHERES_MM[:, [1, 2, 0]] / 60.0)


def test_the_effect_of_a_wrong_tool_frame_passes_when_the_gate_allows_for_it() -> None:
    shared = 2.0 * turned_tool().as_matrix()
    generator = np.random.default_rng(4)
    passed = []
    for _ in range(300):
        tool_mm = generator.normal(0.0, 2.0, 3)
        own_mm = generator.normal(0.0, 0.05, SPHERES_MM.shape)
        measured = SPHERES_MM + turned_tool().apply(tool_mm) + own_mm
        passed.append(
            (
                residual_gate(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, shared).passed,
                residual_gate(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, ALIKE).passed,
            )
        )
    known, unknown = np.mean(passed, axis=0)
    assert known == 1.0
    assert unknown < 0.8


def test_a_moved_sphere_is_found_despite_a_wrong_tool_frame() -> None:
    shared = 2.0 * turned_tool().as_matrix()
    measured = SPHERES_MM + turned_tool().apply([2.0, -1.0, 2.0])
    measured[5, 0] += 1.8
    assert not residual_gate(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, shared).passed
    assert moved_spheres(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, shared)[0] == 5


def test_two_moved_spheres_are_not_explained_by_a_single_one() -> None:
    measured = SPHERES_MM.copy()
    measured[1] += [3.0, 0.0, 0.0]
    measured[4] += [0.0, 4.0, 0.0]
    assert moved_spheres(SPHERES_MM, measured, MEASURED_MM2, ARM_MM, ALIKE) == ()
