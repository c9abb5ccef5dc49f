"""The registration gate allows for an error that poses share, but not for a moved sphere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from procedures.planning.guide import (
    SET_BY_HAND_MM,
    depth_stop_mm,
    direction_covariance_mm2,
    instrument_covariance_mm2,
    place_guide,
    tip_beyond_tool_mm,
)
from procedures.planning.plan_model import FiducialKind, Plan, PlannedTrajectory
from procedures.registration import register
from procedures.steps.clinical.error_budget import (
    GATE_CONFIDENCE,
    REPEATABILITY_MM,
    allow_for_stated_arm,
    find_moved_spheres,
    residual_gate,
)
from ronna_hw.tool_record import GuideBore
from sim.world.rigid import inverse, matrix_from, rotation_from_vector
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.parts import Guide
from sim.world.truth import TrueGuide
from sim.world.world import ArmState, World

ARM_MM = 0.1
MEASURED_MM2 = np.broadcast_to(np.eye(3) * 0.02**2, (8, 3, 3))
ALIKE = np.broadcast_to(2.0 * np.eye(3), (8, 3, 3))  # the tool frame, held alike at every sphere
SPHERES_MM = np.array(
    [[x, y, 20.0 * np.sign(x * y * z) + z] for x in (-60, 60) for y in (-60, 60) for z in (-40, 40)]
)
STATED = allow_for_stated_arm(MEASURED_MM2, ARM_MM, ALIKE)


def test_an_error_that_varies_slowly_over_the_arms_reach_passes() -> None:
    # A stretch of the room along y, as a gear that runs out of true makes it: 0.5 mm over the head.
    measured = SPHERES_MM * (1.0, 1.0 + 0.5 / 120.0, 1.0)
    own = np.eye(3) * (ARM_MM**2 + REPEATABILITY_MM**2)
    plain = register(SPHERES_MM, measured, covariance_mm2=MEASURED_MM2 + own)
    assert not plain.gate(confidence=GATE_CONFIDENCE).passed
    assert residual_gate(SPHERES_MM, measured, STATED).passed


@pytest.mark.parametrize("moved", range(8))
def test_a_sphere_that_moved_by_a_millimetre_and_a_half_is_refused_and_named(moved: int) -> None:
    measured = SPHERES_MM.copy()
    measured[moved, 0] += 1.5
    assert not residual_gate(SPHERES_MM, measured, STATED).passed
    assert find_moved_spheres(SPHERES_MM, measured, STATED)[0] == moved


def turned_tool() -> Rotation:
    """The tool at each sphere, turned by about 8 degrees, as where the joints are to move least."""
    return Rotation.from_rotvec(np.radians(5.0) * SPHERES_MM[:, [1, 2, 0]] / 60.0)


def test_the_effect_of_a_wrong_tool_frame_passes_when_the_gate_allows_for_it() -> None:
    turned = allow_for_stated_arm(MEASURED_MM2, ARM_MM, 2.0 * turned_tool().as_matrix())
    generator = np.random.default_rng(4)
    passed = []
    for _ in range(300):
        tool_mm = generator.normal(0.0, 2.0, 3)
        own_mm = generator.normal(0.0, 0.05, SPHERES_MM.shape)
        measured = SPHERES_MM + turned_tool().apply(tool_mm) + own_mm
        passed.append(
            (
                residual_gate(SPHERES_MM, measured, turned).passed,
                residual_gate(SPHERES_MM, measured, STATED).passed,
            )
        )
    known, unknown = np.mean(passed, axis=0)
    assert known == 1.0
    assert unknown < 0.8


def test_a_moved_sphere_is_found_despite_a_wrong_tool_frame() -> None:
    turned = allow_for_stated_arm(MEASURED_MM2, ARM_MM, 2.0 * turned_tool().as_matrix())
    measured = SPHERES_MM + turned_tool().apply([2.0, -1.0, 2.0])
    measured[5, 0] += 1.8
    assert not residual_gate(SPHERES_MM, measured, turned).passed
    assert find_moved_spheres(SPHERES_MM, measured, turned)[0] == 5


def test_two_moved_spheres_are_not_explained_by_a_single_one() -> None:
    measured = SPHERES_MM.copy()
    measured[1] += [3.0, 0.0, 0.0]
    measured[4] += [0.0, 4.0, 0.0]
    assert find_moved_spheres(SPHERES_MM, measured, STATED) == ()


INSERTIONS = 2000
HELD = rotation_from_vector((0.3, -2.2, 0.5))  # any
DEEP = PlannedTrajectory(id="T1", entry_mm=(0.0, 0.0, 100.0), target_mm=(0.0, 0.0, 10.0), margin_mm=2.0)
PLAN = Plan.model_construct(
    standoff_mm=30.0, instrument_length_mm=300.0, fiducials=FiducialKind.FREE, trajectories=(DEEP,)
)


def bore_of(guide: Guide) -> GuideBore:
    return GuideBore(reach_mm=guide.reach_mm, length_mm=guide.bore_mm, play_mm=guide.play_mm)


def test_the_spread_of_an_instrument_in_the_bore_matches_the_prediction() -> None:
    world = World.create(draw_scene("mini"), paced=False)
    world.publish_arm(ArmState((0.0,) * 6, matrix_from((640.0, 0.0, 300.0), HELD), 0, True))
    guide = TrueGuide(world)
    bore = bore_of(world.scene.mount.guide)
    frame = guide.tip_frame()
    stop_mm = depth_stop_mm(PLAN, DEEP, bore)
    tips = np.array([guide.instrument_tip_mm(stop_mm, "T1", draw) for draw in range(INSERTIONS)])
    seen = np.cov((tips - frame[:3, 3]) @ frame[:3, :3], rowvar=False)
    predicted = frame[:3, :3].T @ instrument_covariance_mm2(PLAN, DEEP, bore, frame[:3, :3]) @ frame[:3, :3]
    np.testing.assert_allclose(np.diag(seen)[:2], np.diag(predicted)[:2], rtol=0.1)
    assert predicted[2, 2] == pytest.approx(SET_BY_HAND_MM**2)


def test_the_tip_of_an_instrument_with_its_planned_stop_is_at_the_target() -> None:
    bore = bore_of(Guide())
    stop_mm = depth_stop_mm(PLAN, DEEP, bore)
    beyond_mm = place_guide(PLAN, DEEP, bore).beyond_mm
    assert beyond_mm + tip_beyond_tool_mm(stop_mm, bore.length_mm, bore.reach_mm) == pytest.approx(0.0)


@pytest.mark.parametrize("entry_z_mm", [30.0, 100.0, 130.0])
def test_the_error_of_a_tilted_bore_matches_the_prediction(entry_z_mm: float) -> None:
    """The record's frame is turned about the mandrel's end, and the arm holds that on the trajectory."""
    bore = bore_of(Guide(play_mm=0.0))
    planned = DEEP.model_copy(update={"entry_mm": (0.0, 0.0, entry_z_mm)})
    stated_rad, generator = 3e-3, np.random.default_rng(1)
    beyond_mm = place_guide(PLAN, planned, bore).beyond_mm
    stop_mm = depth_stop_mm(PLAN, planned, bore)
    tip_in_bore = np.array([0.0, 0.0, tip_beyond_tool_mm(stop_mm, bore.length_mm, bore.reach_mm), 1.0])
    recorded = matrix_from((0.0, 0.0, 0.0), HELD)
    target = recorded @ [0.0, 0.0, -beyond_mm, 1.0]
    misses = []
    for tilt in generator.normal(0.0, stated_rad / np.sqrt(2.0), (500, 2)):
        error = matrix_from((0.0, 0.0, 0.0), rotation_from_vector((*tilt, 0.0)))
        misses.append(((recorded @ inverse(error)) @ tip_in_bore - target)[:3])
    predicted = direction_covariance_mm2(PLAN, planned, bore, stated_rad, HELD)
    rms_mm = np.sqrt(np.mean(np.sum(np.square(misses), axis=1)))
    assert rms_mm == pytest.approx(np.sqrt(np.trace(predicted)), rel=0.1, abs=1e-3)
    assert predicted @ HELD[:, 2] == pytest.approx(np.zeros(3), abs=1e-12)


def test_the_depth_stop_error_equals_that_of_the_simulated_hands() -> None:
    assert Guide().depth_stop_mm == SET_BY_HAND_MM
