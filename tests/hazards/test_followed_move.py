"""Hazard 12: the head moves slightly under the guide, and the registration follows only with consent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clinical_case import CENTRES_CT_MM, FIRST, LAST, ROBOT_FROM_CT, SPHERES_MM, ClinicalCell, done_later
from coded_errors import raises
from numpy.typing import ArrayLike
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_tool,
    coarse,
    localized_fiducials,
    looks_with_tool_error,
    mounted_guide,
    relocalization,
)
from scipy.spatial.transform import Rotation
from watched_case import findings

from procedures.cli.case.commands import carry_out
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.order import Outcome
from procedures.guards.errors import BaseShifted, PatientMoved, PatientUnseen
from procedures.journal.errors import StepRefused
from procedures.operator.question import Topic
from procedures.runs.orders import Run
from procedures.steps.clinical import positioning, registration
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.tool_check import CheckedTool
from procedures.strategies.catalogue import find_strategy
from procedures.workcell import MountedTool
from ronna_hw.arrays import Array

pytestmark = [pytest.mark.hazard(12), pytest.mark.branch("MOVE_FOLLOWED")]

NAME = f"registration:{FIRST}"
TOOL_ERROR_MM = np.array([1.6, -1.2, 0.8])  # of an uncalibrated mount


def moved_mm(
    way_mm: tuple[float, float, float], turn_deg: float = 0.5, about: ArrayLike = (0.0, 0.0, 1.0)
) -> Array:
    """The spheres after the head has turned about its middle and moved."""
    middle = SPHERES_MM.mean(axis=0)
    turn = Rotation.from_rotvec(turn_deg * np.asarray(about), degrees=True)
    return np.asarray(turn.apply(SPHERES_MM - middle) + middle + way_mm)


SMALL_MM = moved_mm((1.0, -2.0, 0.5))


def under_the_guide(cell: ClinicalCell) -> Engine:
    """Everything is registered, and the guide hangs on the arm at home."""
    cell.carrying(MountedTool.STEREO_HEAD)
    before = (*coarse(), checked_plan(), localized_fiducials(), relocalization(), checked_paths(cell))
    engine = cell.begin(*before, registration.STEP, mounted_guide(), checked_tool(), positioning.STEP)
    engine.run_to(engine.order.find("tool_check"))
    cell.carrying(MountedTool.GUIDE).settled()
    return engine


def seen_to_move(cell: ClinicalCell, spheres_mm: Array = SMALL_MM) -> Engine:
    """Before the approach the head is found to have moved."""
    engine = under_the_guide(cell)
    cell.tracker.spheres_mm = spheres_mm
    with pytest.raises(PatientMoved):
        run(engine, f"positioning:{FIRST}")
    assert cell.arm.motions == []
    return engine


def run(engine: Engine, name: str) -> None:
    engine.run_step(engine.order.find(name))


def voided(cell: ClinicalCell) -> list[str]:
    return [step for _, step in cell.entries("voided")]


def test_only_the_registrations_are_voided_and_no_approach_starts_before_they_follow(
    cell: ClinicalCell,
) -> None:
    engine = seen_to_move(cell)
    assert voided(cell) == [NAME, f"registration:{LAST}"]
    assert str(engine.upcoming) == NAME
    with pytest.raises(StepRefused, match=f"{NAME} comes first"):
        run(engine, f"positioning:{FIRST}")


@pytest.mark.parametrize("way_mm", [(1.0, -2.0, 0.5), (10.0, 0.0, 0.0)], ids=["followed or not", "void"])
def test_the_named_command_localizes_again_whether_or_not_the_localization_still_stands(
    cell: ClinicalCell, way_mm: tuple[float, float, float]
) -> None:
    engine = seen_to_move(cell, moved_mm(way_mm))
    localization = engine.order.find("global_localization")
    before = engine.case.record_of(localization)
    assert (before is None) is (way_mm[0] > 5.0)
    assert "localize again: resume the run, or go on with the next step." in PatientMoved.action
    carry_out(engine, Run(step="global_localization"), lambda _line: None)
    assert engine.case.record_of(localization) not in (None, before)


def test_with_consent_the_registration_follows_the_head_and_states_the_added_error(
    cell: ClinicalCell,
) -> None:
    engine = under_the_guide(cell)
    before = cell.case.get(RegisteredRobot, FIRST)
    cell.tracker.spheres_mm = SMALL_MM
    with pytest.raises(PatientMoved):
        run(engine, f"positioning:{FIRST}")
    run(engine, NAME)
    after = cell.case.get(RegisteredRobot, FIRST)
    assert after.result.robot_from_ct.transform.apply(CENTRES_CT_MM) == pytest.approx(SMALL_MM, abs=1e-3)
    move = after.result.followed
    assert move is not None
    assert (move.way_mm, move.turn_deg) == pytest.approx((5.25**0.5, 0.5), abs=1e-3)
    assert after.record.parents == before.record.parents
    assert engine.case.was_superseded(engine.order.find(f"registration:{LAST}"))
    predicted, former = after.result.prediction(FIRST), before.result.prediction(FIRST)
    assert predicted.rms_mm > former.rms_mm
    shares_mm = {share.source: share.rms_mm for share in predicted.budget}
    assert shares_mm["measured head movement"] > 0.0
    (question,) = [one for one in cell.operator.asked if one.topic is Topic.MOVE_FOLLOWED]
    assert "2.29 mm and 0.50 deg" in question.subject
    assert any("follows a head movement" in text for text in findings(cell))


@pytest.mark.parametrize("about_the_axis", [True, False])
def test_the_guide_turns_with_the_head_except_about_its_axis_and_that_is_in_the_predicted_error(
    about_the_axis: bool, cell: ClinicalCell
) -> None:
    engine = under_the_guide(cell)
    pose = cell.case.get(CheckedPaths).result.targets[FIRST].tool_pose.transform.rotation_matrix
    before = cell.case.get(RegisteredRobot, FIRST).result.prediction(FIRST)
    cell.tracker.spheres_mm = moved_mm((1.0, -2.0, 0.5), 1.9, pose[:, 2 if about_the_axis else 0])
    with pytest.raises(PatientMoved):
        run(engine, f"positioning:{FIRST}")
    run(engine, NAME)
    after = cell.case.get(RegisteredRobot, FIRST).result.prediction(FIRST)
    shares = [{share.source: share.rms_mm for share in one.budget} for one in (before, after)]
    across_mm = 2.0**0.5 * cell.setting().settings.tool_error_mm
    expected_mm = across_mm * np.radians(1.9) if about_the_axis else 0.0
    assert shares[0]["tool frame"] == pytest.approx(0.0, abs=1e-6)
    assert shares[1]["tool frame"] == pytest.approx(expected_mm, abs=1e-3)
    name = "links and joint offsets"  # the arm holds the guide with other joints
    assert shares[1][name] != pytest.approx(shares[0][name], rel=1e-3)


def test_the_correction_that_a_learned_arm_is_given_turns_with_the_head(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path, strategy=find_strategy("learning")).carrying(MountedTool.STEREO_HEAD)
    paths = checked_paths(cell)
    checked, measured = looks_with_tool_error(paths, TOOL_ERROR_MM)
    before = (*coarse(), checked_plan(), localized_fiducials(), measured)
    after = (mounted_guide(), checked_tool(), positioning.STEP)
    engine = cell.begin(*before, checked, registration.STEP, *after)
    engine.run_to(engine.order.find("tool_check"))
    aimed_mm = aimed_at_mm(cell)
    about = paths.targets[FIRST].tool_pose.transform.rotation_matrix[:, 0]  # across the axis of the guide
    cell.tracker.spheres_mm = moved_mm((1.0, -2.0, 0.5), 1.9, about)
    cell.carrying(MountedTool.GUIDE).settled()
    with pytest.raises(PatientMoved):
        run(engine, f"positioning:{FIRST}")
    run(engine, "registration")

    done = cell.case.get(RegisteredRobot).result
    assert done.learned is not None
    assert np.linalg.norm(done.learned.corrections_mm[FIRST]) > 1.0
    assert done.followed is not None
    move = done.followed.robot_from_robot.transform
    assert aimed_at_mm(cell) == pytest.approx(move.apply(aimed_mm), abs=0.01)


def aimed_at_mm(cell: ClinicalCell) -> Array:
    """Return the place that the guide is sent to for the first target, robot frame."""
    robot_from_ct = cell.case.get(RegisteredRobot).result.robot_from_ct_at(FIRST)
    return np.asarray(robot_from_ct.apply(checked_plan().trajectory(FIRST).target_mm))


def test_the_guide_goes_to_where_the_head_is_now_and_a_second_move_is_detected(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    engine = seen_to_move(cell)
    run(engine, NAME)
    engine.setting.memory.clear()  # as after a restart
    run(engine, f"positioning:{FIRST}")
    tip_mm = cell.workcell.master.tool_pose().translation_mm
    target_mm = ROBOT_FROM_CT.apply(checked_plan().trajectory(FIRST).target_mm)
    assert np.linalg.norm(tip_mm - target_mm) > 1.0
    again = ClinicalCell(tmp_path / "again")
    engine = seen_to_move(again)
    run(engine, NAME)
    again.tracker.spheres_mm = np.add(SMALL_MM, (0.5, 0.0, 0.0))
    with pytest.raises(PatientMoved):
        run(engine, f"positioning:{FIRST}")


def test_without_consent_the_localization_is_voided(cell: ClinicalCell) -> None:
    engine = seen_to_move(cell)
    cell.operator.refusing = (Topic.MOVE_FOLLOWED,)
    with pytest.raises(PatientMoved, match="the registration was not updated"):
        run(engine, NAME)
    assert voided(cell)[-1] == "global_localization"


def test_a_large_move_voids_the_localization_at_once(cell: ClinicalCell) -> None:
    seen_to_move(cell, moved_mm((6.0, 0.0, 0.0)))
    assert voided(cell) == ["global_localization"]


@pytest.mark.parametrize(
    ("spheres_mm", "frame_shift_mm", "refused"),
    [
        (np.vstack([SMALL_MM[:-1], SMALL_MM[-1:] + 2.0]), (0.0, 0.0, 0.0), PatientMoved),  # not as one body
        (moved_mm((0.0, 0.0, 0.0), 4.0), (0.0, 0.0, 0.0), PatientMoved),  # too far round
        (SMALL_MM, (0.5, 0.0, 0.0), BaseShifted),
        (SMALL_MM[:2], (0.0, 0.0, 0.0), PatientUnseen),
    ],
)
def test_no_other_kind_of_move_is_offered_for_following(
    spheres_mm: Array,
    frame_shift_mm: tuple[float, float, float],
    refused: type[Exception],
    cell: ClinicalCell,
) -> None:
    engine = seen_to_move(cell)
    cell.tracker.spheres_mm, cell.tracker.frame_shift_mm = spheres_mm, frame_shift_mm
    with raises(refused):
        run(engine, NAME)
    assert Topic.MOVE_FOLLOWED not in [question.topic for question in cell.operator.asked]
    assert not engine.case.stands(engine.order.find(NAME))


def test_a_cart_that_moved_with_the_head_is_told_by_the_way_of_the_frame_on_the_arm(
    cell: ClinicalCell,
) -> None:
    engine = seen_to_move(cell)
    cell.tracker.spheres_mm, cell.tracker.frame_shift_mm = SMALL_MM, (0.5, 0.0, 0.0)
    with pytest.raises(
        BaseShifted, match=r"two of head, cart and tracker were moved, one of them by 0\.50 mm"
    ):
        run(engine, NAME)


def test_the_move_is_measured_only_with_the_arm_at_home(cell: ClinicalCell) -> None:
    engine = seen_to_move(cell)
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 0.2, *others)
    with pytest.raises(StepRefused, match="with the arm at home"):
        run(engine, NAME)


def test_a_head_that_moved_back_needs_no_consent(cell: ClinicalCell) -> None:
    engine = seen_to_move(cell)
    cell.tracker.spheres_mm = SPHERES_MM
    run(engine, NAME)
    assert cell.case.get(RegisteredRobot, FIRST).result.followed is None
    assert Topic.MOVE_FOLLOWED not in [question.topic for question in cell.operator.asked]


def test_a_step_that_watches_the_head_where_a_registration_followed_it_descends_from_that(
    cell: ClinicalCell,
) -> None:
    def looks(context: StepContext) -> Outcome[CheckedTool]:
        check_room(context, "here")
        return Outcome(checked_tool())

    cell.carrying(MountedTool.STEREO_HEAD)
    before = (*coarse(), checked_plan(), localized_fiducials(), relocalization(), checked_paths(cell))
    looking = replace(done_later(checked_tool(), *ROOM_READS), run=looks)
    engine = cell.begin(*before, registration.STEP, mounted_guide(), looking, positioning.STEP)
    engine.run_to(engine.order.find("tool_check"))
    cell.carrying(MountedTool.GUIDE).settled()
    room = {cell.case.get(model).record.identifier for model in ROOM_READS}
    assert set(cell.case.get(CheckedTool).record.parents) == room  # nothing of the registrations was used
    cell.tracker.spheres_mm = SMALL_MM
    with pytest.raises(PatientMoved):
        run(engine, "tool_check")
    for name in (NAME, f"registration:{LAST}", "tool_check"):
        run(engine, name)
    followed = cell.case.get(RegisteredRobot, LAST).record.identifier
    assert set(cell.case.get(CheckedTool).record.parents) == {*room, followed}
