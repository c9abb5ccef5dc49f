"""Positioning of the guide before an entry, and its retreat: confirmed first, along one axis."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from clinical_case import (
    FIRST,
    HOME_RAD,
    LAST,
    ROBOT_FROM_CT,
    SPHERES_MM,
    TRACKER_MM,
    TRAJECTORIES,
    ClinicalCell,
    given,
    shifted,
)
from prepared_results import before_positioning, checked_paths, plan, registered_robot
from recording_cell import GUIDE, STEREO_HEAD, RecordingOperator, tool_pose
from watched_case import findings

from procedures.engine.engine import Engine
from procedures.engine.order import Scope
from procedures.guards.errors import BaseShifted, PatientMoved, RoomUndecided
from procedures.guards.room_reading import RoomReading
from procedures.guards.room_watch import RoomLook, RoomWatch
from procedures.journal.errors import GateFailed, StepRefused
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Answer, Question, Topic
from procedures.planning import tracker_sight
from procedures.planning.errors import NotReachable
from procedures.steps.clinical import ct_import
from procedures.steps.clinical.at_target import POSITION_LIMIT_MM, ReachedTarget
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.errors import ToolSeenElsewhere
from procedures.strategies.fixed_orientation import NeutralOrientation
from procedures.strategies.strategy import ONE_SIDE, Strategy, approach_joints
from procedures.workcell import MountedTool
from procedures.workcell.errors import WrongTool
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import ArmReading
from ronna_hw.devices.robot import JointMove
from ronna_hw.records import BadRecord
from ronna_hw.vectors import JointVector

HOMING = (approach_joints(HOME_RAD, ONE_SIDE), HOME_RAD)  # every joint arrives from the same side
SETTLED_HOME = tuple(("joints", joints_rad) for joints_rad in HOMING)


def run(engine: Engine, *names: str) -> None:
    for name in names:
        engine.run_step(engine.order.find(name))


def lower_end_mm(cell: ClinicalCell) -> list[float]:
    reach_mm = cell.workcell.tools.guide.bore.reach_mm
    return tool_pose(cell.arm.joints_rad, cell).apply([0.0, 0.0, -reach_mm]).tolist()


def before_entry_mm(trajectory: str) -> list[float]:
    """Where the lower end of the guide is to be held."""
    planned = plan().trajectory(trajectory)
    outwards = np.subtract(planned.entry_mm, planned.target_mm) / planned.depth_mm
    return ROBOT_FROM_CT.apply(planned.entry_mm + plan().standoff_mm * outwards).tolist()


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
def test_the_guide_stops_before_the_entry_after_moving_along_the_axis(
    cell: ClinicalCell, trajectory: str
) -> None:
    run(before_positioning(cell), f"positioning:{trajectory}")
    assert lower_end_mm(cell) == pytest.approx(before_entry_mm(trajectory), abs=1e-6)
    below, home, (_, over), (kind, held) = cell.arm.motions
    assert (below, home) == SETTLED_HOME
    assert kind == "line"
    way_mm = math.dist(tool_pose(over, cell).translation_mm, tool_pose(held, cell).translation_mm)

    assert way_mm == pytest.approx(60.0)
    place = cell.workcell.master.place
    assert (place.is_on_axis, place.trajectory) == (True, trajectory)
    assert cell.motions("insert") == [trajectory]
    stored = cell.case.get(PositionedGuide, trajectory)
    assert stored.result.joints_rad == cell.arm.joints_rad
    assert {name.partition("-")[2] for name in stored.record.parents} == {
        *("registration", "tool_change", "tool_check", "path_check", "plan_check", "fiducial_localization"),
        *("global_localization", "correspondence"),  # checked with
    }


@pytest.mark.hazard(36)
def test_the_arm_does_not_move_without_confirmation(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.APPROACH)
    with pytest.raises(NotConfirmed, match=f"Move home, .*, then over {FIRST}"):
        run(before_positioning(cell), f"positioning:{FIRST}")
    assert cell.arm.motions == []
    assert cell.arm.calls == ["surround"]


@pytest.mark.hazard(37)
def test_the_mounted_tool_is_read_again_before_the_arm_moves(cell: ClinicalCell) -> None:
    engine = before_positioning(cell)
    cell.arm.mounted = STEREO_HEAD
    with pytest.raises(WrongTool, match=f"guide, number {GUIDE}, got number {STEREO_HEAD}"):
        run(engine, f"positioning:{FIRST}")
    assert cell.operator.asked == []
    assert cell.arm.motions == []


@pytest.mark.parametrize("strategy", [None, NeutralOrientation()], ids=["as localized", "as planned"])
def test_the_guide_is_held_in_the_orientation_of_the_localization_or_of_the_path_check_by_strategy(
    cell: ClinicalCell, strategy: Strategy | None
) -> None:
    cell.strategy = strategy or cell.strategy
    run(before_positioning(cell, turn_rad=0.3), f"positioning:{LAST}")
    held = cell.case.get(PositionedGuide, LAST).result.tool_pose.transform
    paths = checked_paths(cell, turn_rad=0.3)
    of = paths.targets[LAST] if strategy else paths.localizations[LAST][0]
    assert (held.rigid.rotation.inv() * of.tool_pose.transform.rigid.rotation).magnitude() < 1e-9


@pytest.mark.hazard(46)
def test_a_guide_that_is_held_turned_when_it_comes_to_rest_is_refused(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = before_positioning(cell)
    cell.tracker.guide_shift_mm = None  # the frame on the guide is hidden, and cannot tell
    move = cell.arm.move_joints

    def move_and_turn(motion: JointMove) -> ArmReading:
        at_home = np.allclose(motion.target_rad, HOME_RAD)
        cell.tracker.frame_turn_rad = (0.0, 0.0 if at_home else math.radians(0.8), 0.0)
        return move(motion)

    monkeypatch.setattr(cell.arm, "move_joints", move_and_turn)
    refused = rf"PRO-052: the frame on the arm is not where the arm has it.*at {FIRST}: the guide is pushed"
    with pytest.raises(RoomUndecided, match=refused):
        run(engine, f"positioning:{FIRST}")
    assert cell.entries("voided") == []
    monkeypatch.undo()
    cell.tracker.frame_turn_rad = (0.0, 0.0, 0.0)
    engine.retreat_home()
    run(engine, f"positioning:{FIRST}", f"at_target:{FIRST}")  # as the message says


@pytest.mark.hazard(13)
def test_a_hand_that_touches_the_arm_at_home_in_passing_costs_no_localization(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = before_positioning(cell)
    compare = RoomWatch.compare
    run(engine, f"positioning:{FIRST}")
    engine.retreat_home()

    def touched(watch: RoomWatch, reading: RoomReading, now_s: float = 0.0) -> RoomLook:
        looked = compare(watch, reading, now_s)
        cell.tracker.frame_shift_mm = (0.0, 0.0, 0.0)  # the hand goes on
        return looked

    monkeypatch.setattr(RoomWatch, "compare", touched)
    cell.tracker.frame_shift_mm = (0.0, 1.0, 0.0)
    run(engine, f"positioning:{FIRST}")
    assert cell.entries("voided") == []
    (found,) = (one for one in findings(cell) if "somebody has touched the arm" in one)
    assert "the frame on the arm by 1.0" in found


@pytest.mark.hazard(47)
def test_a_guide_whose_seat_gave_way_after_its_check_is_not_led_to_the_entry(cell: ClinicalCell) -> None:
    engine = before_positioning(cell)
    been = len(cell.arm.motions)
    cell.tracker.guide_shift_mm = (0.0, 2.0, 0.0)
    with pytest.raises(ToolSeenElsewhere):
        run(engine, f"positioning:{FIRST}")
    assert len(cell.arm.motions) == been
    assert cell.arm.state is Lifecycle.CONFIGURED  # hands reseat it: no stream that a motion could follow


def test_a_frame_on_the_arm_that_was_moved_is_not_taken_for_a_seat_that_gave_way(cell: ClinicalCell) -> None:
    engine = before_positioning(cell)
    cell.tracker.frame_shift_mm = (0.0, 5.0, 0.0)
    with pytest.raises(BaseShifted):
        run(engine, f"positioning:{FIRST}")


def test_an_arm_that_arrived_is_at_the_target(cell: ClinicalCell) -> None:
    run(before_positioning(cell), f"positioning:{FIRST}", f"at_target:{FIRST}")
    reached = cell.case.get(ReachedTarget, FIRST)
    assert reached.result.nominal_error_mm < 1e-6
    assert {name.partition("-")[2] for name in reached.record.parents} == {"positioning-T1", "plan_check"}


def test_an_arm_off_its_position_is_not_at_the_target(cell: ClinicalCell) -> None:
    engine = before_positioning(cell)
    run(engine, f"positioning:{FIRST}")
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 2 * POSITION_LIMIT_MM / 700.0, *others)
    with pytest.raises(GateFailed, match=r"the arm is not where it was sent; limit 0\.05 mm"):
        run(engine, f"at_target:{FIRST}")


@pytest.mark.hazard(24)
def test_the_retreat_reverses_the_approach(cell: ClinicalCell) -> None:
    run(before_positioning(cell), *(f"{name}:{FIRST}" for name in ("positioning", "at_target", "retreat")))
    *before, (_, over), (_, _), (kind, back), below, home = cell.arm.motions
    assert kind == "line"
    assert back == pytest.approx(over, abs=1e-6)
    assert tuple(before) == (below, home) == SETTLED_HOME
    assert not cell.workcell.master.place.is_on_axis


TARGETING = ("positioning", "at_target", "retreat")


@pytest.mark.parametrize("order", [(FIRST, LAST), (LAST, FIRST)])
def test_the_arm_parks_after_each_target_in_either_order(cell: ClinicalCell, order: tuple[str, str]) -> None:
    engine = before_positioning(cell)
    for trajectory in order:
        run(engine, *(f"{name}:{trajectory}" for name in TARGETING))
        assert cell.case.get(Retreated, trajectory).result.joints_rad == HOME_RAD
        assert cell.arm.joints_rad == HOME_RAD
        assert cell.arm.state is Lifecycle.CONFIGURED
    assert engine.machine.state == "finished"


def test_an_arm_that_came_home_from_a_target_is_not_sent_there_again_before_the_next(
    cell: ClinicalCell,
) -> None:
    engine = before_positioning(cell)
    run(engine, *(f"{name}:{FIRST}" for name in TARGETING))
    been = len(cell.arm.motions)
    run(engine, f"positioning:{LAST}")
    assert cell.operator.asked[-1].subject.startswith(f"Move over {LAST}")
    assert [kind for kind, _ in cell.arm.motions[been:]] == ["joints", "line"]


@pytest.mark.hazard(24)
def test_with_the_guide_before_an_entry_only_the_next_step_of_its_trajectory_may_run(
    cell: ClinicalCell,
) -> None:
    engine = before_positioning(cell)
    run(engine, f"positioning:{FIRST}")
    for name in (f"positioning:{LAST}", f"at_target:{LAST}", f"retreat:{FIRST}", f"positioning:{FIRST}"):
        with pytest.raises(StepRefused, match=f"only at_target:{FIRST} may"):
            run(engine, name)


def test_an_offset_registration_offsets_the_guide_by_the_same_amount(cell: ClinicalCell) -> None:
    registered = registered_robot(shifted(ROBOT_FROM_CT, (2.0, 0.0, -1.0)))
    run(before_positioning(cell, registered), f"positioning:{FIRST}")
    expected = [a + b for a, b in zip(before_entry_mm(FIRST), (2.0, 0.0, -1.0), strict=True)]
    assert lower_end_mm(cell) == pytest.approx(expected, abs=1e-6)


@pytest.mark.hazard(3)
@pytest.mark.hazard(37)
def test_nothing_moves_if_the_tool_is_exchanged_while_the_question_is_open(cell: ClinicalCell) -> None:
    class Exchanger(RecordingOperator):
        def ask(self, question: Question) -> Answer:
            cell.arm.mounted = STEREO_HEAD
            return super().ask(question)

    cell.operator = Exchanger()
    engine = before_positioning(cell)
    with pytest.raises(WrongTool, match="PRO-009"):
        run(engine, f"positioning:{FIRST}")
    assert cell.arm.motions == []


@pytest.mark.hazard(24)
def test_a_damaged_record_does_not_keep_the_guide_from_retreating(cell: ClinicalCell) -> None:
    engine = before_positioning(cell)
    run(engine, f"positioning:{FIRST}", f"at_target:{FIRST}")
    for path in (cell.folder / "records").iterdir():
        path.unlink()
    with pytest.raises(BadRecord):
        run(engine, f"retreat:{FIRST}")
    assert not cell.workcell.master.place.is_on_axis


def test_a_step_that_would_need_a_new_localization_is_not_repeated_with_the_guide_mounted(
    cell: ClinicalCell,
) -> None:
    cell.carrying(MountedTool.GUIDE)
    engine = cell.begin(ct_import.STEP)
    with pytest.raises(StepRefused, match=r"localized again; .* start a new run"):
        run(engine, "ct_import")


@pytest.mark.hazard(23)
@pytest.mark.branch("NOT_CLEAR_NOW")
def test_a_blocked_target_is_refused_and_its_trajectory_named(cell: ClinicalCell) -> None:
    engine = before_positioning(cell)
    cell.arm.blocked = lambda _start, target: target not in HOMING
    with pytest.raises(NotReachable, match=f"{FIRST} cannot be reached: the way is not clear"):
        run(engine, f"positioning:{FIRST}")
    assert {joints_rad for _, joints_rad in cell.arm.motions} == set(HOMING)
    assert cell.arm.joints_rad == HOME_RAD
    assert engine.machine.state == "held"


def test_a_target_refused_after_the_arm_has_moved_is_not_reported_as_if_nothing_had(
    cell: ClinicalCell,
) -> None:
    engine = before_positioning(cell)

    def block_the_line(_start: JointVector, target: JointVector) -> bool:
        if target not in HOMING:
            cell.arm.failing = NotClear("the way is not clear")
        return False  # the way over the entry is

    cell.arm.blocked = block_the_line
    with pytest.raises(NotReachable, match=r"the way is not clear.*; the arm has moved") as refused:
        run(engine, f"positioning:{FIRST}")
    assert refused.value.advice.startswith("The arm is on its way: send it home.")
    assert not cell.workcell.master.place.is_home


def after_a_fault(cell: ClinicalCell) -> Engine:
    cell.strategy = NeutralOrientation()
    engine = before_positioning(cell, replace(given(registered_robot()), scope=Scope.LOCALIZATION))
    cell.arm.state = Lifecycle.FAULT
    engine.faults.acknowledge("A. Nurse")
    return engine


@pytest.mark.hazard(12)
@pytest.mark.branch("KEPT_REGISTRATION")
def test_the_operator_is_asked_once_whether_to_keep_a_registration_from_before_a_fault(
    cell: ClinicalCell,
) -> None:
    run(after_a_fault(cell), *(f"{name}:{FIRST}" for name in ("positioning", "at_target", "retreat")))
    kept = [one.name for one in cell.operator.asked if one.topic is Topic.REGISTRATION_KEPT]
    assert kept == [f"registration_kept:{FIRST}"]


@pytest.mark.hazard(12)
@pytest.mark.branch("KEPT_REGISTRATION")
def test_a_registration_from_before_a_fault_moves_nothing_unless_it_is_kept(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.REGISTRATION_KEPT)
    with pytest.raises(GateFailed, match="older than a fault of the arm"):
        run(after_a_fault(cell), f"positioning:{FIRST}")
    assert cell.arm.motions == []


@pytest.mark.hazard(36)
def test_the_instrument_stays_at_its_target_until_the_operator_confirms_the_depth(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.AT_TARGET)
    engine = before_positioning(cell)
    run(engine, f"positioning:{FIRST}")
    with pytest.raises(NotConfirmed, match="nobody confirmed at T1 that the instrument is at depth"):
        run(engine, f"at_target:{FIRST}")
    asked = cell.operator.asked[-1]
    assert asked.subject == f"Is the instrument at depth at {FIRST}, and is the work there done?"
    assert asked.answers == ("yes", "hold the guide")
    assert "hold the guide: nothing moves and the step ends" in asked.value
    assert engine.instrument_in == FIRST
    assert cell.case.find(ReachedTarget, FIRST) is None


@pytest.mark.hazard(12)
@pytest.mark.hazard(36)
@pytest.mark.parametrize("in_the_way", [True, False])
def test_the_approach_is_confirmed_once_and_the_question_says_when_the_arm_will_hide_the_head(
    in_the_way: bool, cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = before_positioning(cell)
    if in_the_way:  # a tracker behind the hand
        hand = cell.arm.kinematics.flange_pose(checked_paths(cell).targets[FIRST].joints_rad)
        monkeypatch.setattr(tracker_sight, "SENSORS_MM", (hand.translation_mm - TRACKER_MM,) * 2)
    run(engine, f"positioning:{FIRST}")
    (question,) = cell.operator.asked
    assert question.topic is Topic.APPROACH
    assert ("hide the head from the tracker" in question.subject) is in_the_way


@pytest.mark.hazard(12)
def test_an_arm_that_is_elsewhere_returns_home_and_the_head_is_checked_there_before_a_target(
    cell: ClinicalCell,
) -> None:
    engine = before_positioning(cell)
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 0.1, *others)
    cell.tracker.spheres_mm = SPHERES_MM[:2]  # the arm hides the others
    been = len(cell.arm.motions)

    def seen_again(_start: JointVector, _target: JointVector) -> bool:
        cell.tracker.spheres_mm = np.add(SPHERES_MM, (0.0, 0.5, 0.0))  # but it has moved
        return False

    cell.arm.blocked = seen_again
    with pytest.raises(PatientMoved):
        run(engine, f"positioning:{LAST}")
    assert tuple(cell.arm.motions[been:]) == SETTLED_HOME
    assert cell.operator.asked[-1].subject.startswith("Move home, where the tracker sees head and arm")
