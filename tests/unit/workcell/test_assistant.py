"""The assistant with an instrument in the guide: straight along the axis it is on, or not at all."""

from __future__ import annotations

from contextlib import nullcontext
from math import radians
from types import SimpleNamespace
from typing import Any, NoReturn, cast

import pytest
from coded_errors import raises
from ideal_arm import Controller, IdealArm
from recording_cell import RecordingCell

from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.operator.checkpoint import Checkpoint
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import YES, Topic
from procedures.workcell.arm_history import ArmHistory, ArmLog, HeldInstrument, InsertionAxis, arm_history
from procedures.workcell.arms import Arms
from procedures.workcell.assistant import (
    INSTRUMENT,
    ONE_LOOK_MM,
    TURNED_CART,
    TURNED_SHARE,
    Assistant,
    GuidedStretch,
)
from procedures.workcell.errors import OtherArmUnknown, TipOffAxis
from procedures.workcell.master import Master
from procedures.workcell.motions import PlannedMotion
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibration import PoseRecord
from ronna_hw.clock import HostClock
from ronna_hw.config import Calibrations, DeviceConfig
from ronna_hw.devices import LineMove
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform
from ronna_hw.roles import ASSISTANT, MASTER
from sim.world.scene.arm_design import KR6

CLOCK = HostClock()
BALL_MM = (0.0, 0.0, 160.0)
TRAVEL_MM = 100.0


@pytest.fixture
def arm() -> IdealArm:
    arm = IdealArm("robot.assistant", DeviceConfig(driver="ideal", endpoint="host:"), CLOCK)
    arm.controller = Controller(IdealArm.kinematics.home_rad)
    arm.connect()
    return arm


@pytest.fixture
def assistant(cell: RecordingCell, arm: IdealArm, monkeypatch: pytest.MonkeyPatch) -> Assistant:
    """An assistant that holds an instrument in the guide, where its clamp stands now."""
    monkeypatch.setattr(
        "procedures.workcell.supervised_arm.calibrated_arm", lambda nominal, **_: CalibratedArm(nominal)
    )
    across = (0.5**0.5, 0.0, 0.5**0.5, 0.0)
    clamp = PoseRecord(translation_mm=(0.0, 0.0, 110.0), quaternion_wxyz=across)
    holder = SimpleNamespace(frame="holder", flange_from_clamp=clamp, flange_from_ball_mm=BALL_MM)
    records = SimpleNamespace(arms=dict.fromkeys((MASTER, ASSISTANT)), assistant_holder=holder)
    log = ArmLog(cell.journal, CLOCK, ArmHistory(ASSISTANT))
    arms = Arms({MASTER: arm, ASSISTANT: arm}, (MASTER, ASSISTANT), CLOCK, lambda: "T1")
    assistant = Assistant(ASSISTANT, log, arms, cast("Calibrations", records), None)
    assistant.record_base(Transform.of(Frame.ROBOT, Frame.ASSISTANT))
    held = assistant.clamp_pose(assistant.joints_rad())
    axis = assistant.axis_in_base(InsertionAxis("T1", held, TRAVEL_MM))
    log.note(
        Entry.PLACED,
        joints_rad=list(assistant.joints_rad()),
        at_home=False,
        trajectory="T1",
        axis=axis.as_plain(),
    )
    return assistant


def test_a_retreat_begins_where_the_instrument_is(assistant: Assistant) -> None:
    with pytest.raises(NotConfirmed):  # allowed, but no case is open
        assistant.supervised.carry_out(assistant.withdraw_motion())


@pytest.mark.hazard(59)
def test_an_instrument_beside_its_axis_is_not_led_along_it(assistant: Assistant, arm: IdealArm) -> None:
    first, *others = arm.controller.joints_rad
    arm.controller.joints_rad = (first + radians(1.0), *others)
    with pytest.raises(TipOffAxis, match="PRO-015: the assistant is not on the axis of T1"):
        assistant.supervised.carry_out(assistant.withdraw_motion())


@pytest.mark.hazard(59)
def test_an_assistant_that_was_jogged_is_where_its_joints_say(assistant: Assistant, arm: IdealArm) -> None:
    assistant.restore_home(IdealArm.kinematics.home_rad)
    first, *others = arm.controller.joints_rad
    arm.controller.joints_rad = (first + radians(20.0), *others)
    assistant.compare_place()
    assert assistant.place.is_on_axis
    with pytest.raises(TipOffAxis, match="PRO-015"):
        assistant.require_on_axis()
    arm.controller.joints_rad = IdealArm.kinematics.home_rad
    assistant.compare_place()  # led out and home by hand
    assert assistant.place.is_home
    assert not assistant.place.is_on_axis


@pytest.mark.hazard(59)
def test_the_assistant_is_compared_also_if_the_other_arm_reports_no_joints(
    assistant: Assistant, cell: RecordingCell, arm: IdealArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.add_assistant(assistant)
    cell.workcell.master.restore_home(IdealArm.kinematics.home_rad)
    assistant.restore_home(IdealArm.kinematics.home_rad)
    arm.controller.joints_rad = IdealArm.kinematics.home_rad

    def report_nothing() -> NoReturn:
        raise OtherArmUnknown("no joints")

    monkeypatch.setattr(cell.workcell.master, "joints_rad", report_nothing)
    with pytest.raises(OtherArmUnknown, match="no joints"):
        cell.workcell.compare_places()
    assert assistant.place.is_home


@pytest.mark.hazard(59)
def test_after_a_stop_the_next_motion_of_the_assistant_is_confirmed_anew(
    assistant: Assistant, cell: RecordingCell
) -> None:
    checkpoint = Checkpoint(lambda _question: YES, lambda _state, _reason: nullcontext(), CLOCK)
    cell.add_assistant(assistant)
    assistant.supervised.ask_before(checkpoint, lambda _question: YES)
    assistant.supervised.confirm(Topic.RETREAT, "retreat", [])
    cell.workcell.stop()
    assistant.supervised.ask_before(checkpoint, lambda _question: "no")
    with pytest.raises(NotConfirmed, match="then as listed"):
        assistant.supervised.carry_out(assistant.withdraw_motion())


def test_the_assistant_takes_no_pose_in_the_robot_frame_for_one_in_its_base(assistant: Assistant) -> None:
    flange = assistant.flange_pose(assistant.joints_rad())
    assert flange.target is Frame.ASSISTANT
    with raises(FRAME_MISMATCH, match="FRM-001"):
        assistant.flange_joints(assistant.base @ flange, assistant.joints_rad())


def test_where_the_assistant_stands_outlasts_the_program(assistant: Assistant, cell: RecordingCell) -> None:
    base = Transform.of(Frame.ROBOT, Frame.ASSISTANT, translation_mm=(700.0, -500.0, 0.0))
    assistant.place_base(base)
    assistant.place_base(base)
    lines = [line for line in read_journal(cell.folder / JOURNAL_FILE) if line["entry"] == Entry.BASE]
    assert len(lines) == 2  # the first is of the fixture
    known = arm_history(lines, ASSISTANT).base
    assert known is not None
    assert known.translation_mm == pytest.approx((700.0, -500.0, 0.0))


@pytest.mark.hazard(62)
def test_an_instrument_that_would_stand_in_the_arm_itself_is_not_clear_at_rest(
    assistant: Assistant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(IdealArm, "kinematics", find_arm("kr6_r900_sixx").kinematics)
    home_rad = tuple(map(radians, KR6.assistant_home_deg))
    turned_rad = (*home_rad[:-1], radians(60.0))
    assistant.surround(Surroundings(), home_rad)
    assert assistant.rests_clear(home_rad, 0.0)
    assert not assistant.rests_clear(home_rad, 170.0)
    assert assistant.rests_clear(turned_rad, 170.0)


@pytest.mark.hazard(63)
def test_what_the_holder_holds_outlasts_the_program_until_it_is_confirmed_to_be_empty(
    assistant: Assistant, cell: RecordingCell
) -> None:
    empty = assistant.tool()
    assistant.hold_instrument(HeldInstrument("T1", 170.0, ("bore",)))
    lines = read_journal(cell.folder / JOURNAL_FILE)
    assert arm_history(lines, ASSISTANT).held == HeldInstrument("T1", 170.0, ("bore",))
    assert arm_history(lines).held is None  # of the master
    assert [part.name for part in assistant.tool()] == [*(part.name for part in empty), INSTRUMENT]
    assistant.release_instrument()
    assert assistant.tool() == empty
    assert arm_history(read_journal(cell.folder / JOURNAL_FILE), ASSISTANT).held is None


GUIDED = GuidedStretch(22.0, 60.0)


def travels_mm(assistant: Assistant, motion: PlannedMotion) -> list[float]:
    axis = assistant.place.axis
    assert axis is not None
    return [axis.travel_from_start_mm(cast("LineMove", leg).target) for leg in motion.legs]


def test_the_instrument_is_led_slowly_to_the_guide_and_from_off_the_skin_on(assistant: Assistant) -> None:
    axis = assistant.place.axis
    assert axis is not None
    motion = assistant.insert_motion(axis, guided=GUIDED)
    assert travels_mm(assistant, motion) == pytest.approx([22.0, 60.0, TRAVEL_MM], abs=1e-6)
    slow, guided, into_head = (leg.speed_fraction for leg in motion.legs)
    assert slow == into_head < guided


def test_an_arm_that_senses_force_watches_it_all_the_way_also_where_it_is_faster(
    assistant: Assistant,
) -> None:
    axis = assistant.place.axis
    assert axis is not None
    motion = assistant.insert_motion(axis, guided=GUIDED)
    watched = [assistant.force_limited(leg, motion, 15.0) for leg in motion.legs]
    assert [one and (one.force_limit_N, one.in_bore, one.speed_mm_s) for one in watched] == [
        (15.0, False, 5.0),
        (15.0, True, 15.0),
        (15.0, False, 5.0),
    ]


def test_an_insertion_goes_on_from_where_it_was_stopped_and_never_back(
    assistant: Assistant, arm: IdealArm
) -> None:
    axis = assistant.place.axis
    assert axis is not None
    motion = assistant.insert_motion(axis, guided=GUIDED)
    assert [assistant.has_passed(leg, motion) for leg in motion.legs] == [True, True, False]
    there = assistant.base @ axis.pose_at(40.0)
    arm.controller.joints_rad = assistant.clamp_joints(there, assistant.joints_rad())
    assert [assistant.has_passed(leg, motion) for leg in motion.legs] == [True, False, False]
    out = assistant.withdraw_motion(GUIDED)
    assert [assistant.has_passed(leg, out) for leg in out.legs] == [True, False]


HEAD = Obstacle("head", Capsule((500.0, 0.0, 0.0), (500.0, 0.0, 0.0), 90.0), True)
ON_CART = Obstacle("cabinet", Capsule((0.0, 0.0, -300.0), (0.0, 0.0, -400.0), 200.0))
AROUND = Surroundings(obstacles=(HEAD, ON_CART))
BASE = Transform.of(Frame.ROBOT, Frame.ASSISTANT, translation_mm=(-1300.0, 0.0, 0.0))
MOVED = Transform.of(Frame.ROBOT, Frame.ROBOT, translation_mm=(0.0, 40.0, 0.0))


class StandIn:
    """Arm that records what it declares: of the master, its surroundings; of the assistant, its base."""

    role = ASSISTANT

    def __init__(self) -> None:
        self.surroundings, self.base = AROUND, BASE
        self.history = SimpleNamespace(base_uncertain_mm=1.0)
        self.among_arms: list[tuple[str, Pose, float]] = []
        self._arms = SimpleNamespace(
            placed=SimpleNamespace(is_placed=lambda _role: True),
            place=lambda *placed: self.among_arms.append(placed),
        )
        self.recorded: list[tuple[Transform, float]] = []
        self.placed: list[tuple[Transform, float]] = []

    def _declare(self, around: Surroundings) -> None:
        self.surroundings = around

    def record_base(self, base: Transform, uncertain_mm: float) -> None:
        self.recorded.append((base, uncertain_mm))

    def place_base(self, base: Transform, uncertain_mm: float) -> None:
        self.placed.append((base, uncertain_mm))

    def _surround_again(self) -> None:
        pass


@pytest.mark.hazard(58)
def test_a_moved_cart_of_the_master_moves_head_and_assistant_against_it() -> None:
    master, assistant = StandIn(), StandIn()
    Master.shift_room(cast("Any", master), MOVED, [ON_CART.name])
    Assistant.shift_room(cast("Any", assistant), MOVED, [ON_CART.name])
    head, cabinet = master.surroundings.obstacles
    assert head.capsule.start_mm == pytest.approx((500.0, 40.0, 0.0))
    assert cabinet == ON_CART
    ((role, base, uncertain_mm),) = assistant.among_arms
    assert role == ASSISTANT
    assert base.position_mm == pytest.approx((-1300.0, 40.0, 0.0))
    assert uncertain_mm == 1.0 + ONE_LOOK_MM


@pytest.mark.hazard(58)
def test_a_later_program_knows_how_far_the_assistant_may_be_from_where_it_has_it() -> None:
    """It has the head where it was as well: both fit together."""
    assistant = StandIn()
    Assistant.shift_room(cast("Any", assistant), MOVED, [])
    assert assistant.recorded == [(BASE, 1.0 + 40.0)]


@pytest.mark.hazard(58)
def test_an_assistant_that_was_seen_elsewhere_is_kept_farther_away() -> None:
    assistant = StandIn()
    Assistant.doubt(cast("Any", assistant), 3.0)
    assert assistant.placed == [(BASE, 1.0 + TURNED_CART * 3.0)]


@pytest.mark.hazard(58)
def test_an_assistant_is_taken_for_where_its_frame_was_seen_on_the_way_home() -> None:
    assistant = StandIn()
    Assistant.follow(cast("Any", assistant), (0.0, 20.0, 0.0))
    ((base, uncertain_mm),) = assistant.placed
    assert base.translation_mm == pytest.approx((-1300.0, 20.0, 0.0))
    assert uncertain_mm == 1.0 + ONE_LOOK_MM + TURNED_SHARE * 20.0
