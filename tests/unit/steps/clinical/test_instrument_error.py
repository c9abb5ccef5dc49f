"""The predicted error of guide and instrument matches that of the simulated guide and instrument."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.planning.guide import (
    SET_BY_HAND_MM,
    depth_stop_mm,
    direction_covariance_mm2,
    held_trajectory,
    instrument_covariance_mm2,
)
from procedures.planning.plan_model import FiducialKind, Plan, PlannedTrajectory
from ronna_hw.tool_record import GuideBore
from sim.world.rigid import inverse, matrix_from, rotation_from_vector
from sim.world.scene.guide import Guide
from sim.world.scene.named_scenes import named_scene
from sim.world.true_guide import TrueGuide
from sim.world.world import ArmState, World

INSERTIONS = 2000
HELD = rotation_from_vector((0.3, -2.2, 0.5))  # any
DEEP = PlannedTrajectory(id="T1", entry_mm=(0.0, 0.0, 100.0), target_mm=(0.0, 0.0, 10.0), margin_mm=2.0)
PLAN = Plan.model_construct(
    standoff_mm=30.0, instrument_length_mm=300.0, fiducials=FiducialKind.FREE, trajectories=(DEEP,)
)


def bore_of(guide: Guide) -> GuideBore:
    return GuideBore(reach_mm=guide.reach_mm, length_mm=guide.bore_mm, play_mm=guide.play_mm)


def test_the_spread_of_an_instrument_in_the_bore_matches_the_prediction() -> None:
    world = World.create(named_scene("mini"), paced=False)
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


@pytest.mark.parametrize("entry_z_mm", [30.0, 100.0, 130.0])
def test_the_error_of_a_tilted_bore_matches_the_prediction(
    entry_z_mm: float,
) -> None:
    """The record's frame is turned about the mandrel's end, and the arm holds that on the trajectory."""
    bore = bore_of(Guide(play_mm=0.0))
    planned = DEEP.model_copy(update={"entry_mm": (0.0, 0.0, entry_z_mm)})
    stated_rad, generator = 3e-3, np.random.default_rng(1)
    beyond_mm = held_trajectory(PLAN, planned, bore).beyond_mm
    tip_in_bore = np.array(
        [0.0, 0.0, depth_stop_mm(PLAN, planned, bore) - bore.length_mm - bore.reach_mm, 1.0]
    )
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
