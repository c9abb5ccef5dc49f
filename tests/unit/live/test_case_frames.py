"""Frames of a running case whose arm was learned: at a target, by the pose that is corrected for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clinical_case import FIRST, ROBOT_FROM_CT, ClinicalCell
from prepared_results import before_positioning, checked_plan, learned_arm, registered_robot

from procedures.engine.engine import Engine
from procedures.live.case_frames import CaseFrames
from procedures.live.records import FramePose
from procedures.reporting.case_figures import read_case_figures
from procedures.steps.clinical.results import RegisteredRobot
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform

CORRECTION_MM = (1.0, 3.0, -2.0)
TARGET_CT_MM = checked_plan().plan.trajectory(FIRST).target_mm


def learned_robot() -> RegisteredRobot:
    return registered_robot().model_copy(update={"learned": learned_arm(CORRECTION_MM)})


def shown_target_mm(frames: CaseFrames) -> Array:
    """Return where a client of the live frames puts the first target, robot frame."""
    (found,) = [
        one
        for one in frames.changes(0.0)
        if isinstance(one, FramePose) and (one.parent, one.child) == (Frame.CT, Frame.ROBOT)
    ]
    assert found.translation_mm is not None
    assert found.rotation is not None
    ct_from_robot = Transform.of(
        Frame.CT, Frame.ROBOT, translation_mm=found.translation_mm, quaternion_wxyz=found.rotation
    )
    return np.asarray(ct_from_robot.inverse().apply(TARGET_CT_MM))


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    return before_positioning(ClinicalCell(tmp_path), learned_robot())


@pytest.mark.hazard(67)
def test_at_a_target_the_live_frames_put_the_guide_on_it_and_before_they_show_the_head_as_registered(
    engine: Engine,
) -> None:
    frames, place_mm = CaseFrames(engine), ROBOT_FROM_CT.apply(TARGET_CT_MM)
    np.testing.assert_allclose(shown_target_mm(frames), place_mm, atol=1e-9)
    engine.run_step(engine.order.find(f"positioning:{FIRST}"))
    np.testing.assert_allclose(shown_target_mm(frames), place_mm + CORRECTION_MM, atol=1e-9)


@pytest.mark.hazard(67)
def test_the_drawn_head_and_its_targets_are_in_one_pose_by_which_the_guide_is_on_its_target(
    engine: Engine,
) -> None:
    for corrected_mm in (np.zeros(3), np.array(CORRECTION_MM)):
        figures = read_case_figures(engine.case.folder)
        assert figures.robot_from_ct is not None
        drawn_mm = figures.robot_from_ct.apply(TARGET_CT_MM)
        np.testing.assert_allclose(figures.trajectories[0].target_mm, drawn_mm, atol=1e-9)
        np.testing.assert_allclose(drawn_mm, ROBOT_FROM_CT.apply(TARGET_CT_MM) + corrected_mm, atol=1e-9)
        if not corrected_mm.any():
            engine.run_step(engine.order.find(f"positioning:{FIRST}"))
