"""What is answered to each telegram: motion, stops, losses, faults. No sockets, no clock but the test's."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from math import degrees, radians
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.kuka_rsi.link_state import (
    Command,
    CommandKind,
    Fault,
    Orders,
    Phase,
    Result,
    StopOrder,
)
from drivers.kuka_rsi.losses import Losses
from drivers.kuka_rsi.session import Session
from drivers.kuka_rsi.settings import LinkSettings
from drivers.kuka_rsi.telegram import Telegram
from ronna_hw.arm.kinematics import forward
from ronna_hw.arm.limits import working_limits
from ronna_hw.arm.model import arm_model, radians6
from ronna_hw.arm.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.progress import PathLimits
from ronna_hw.devices.readings import JointVector

MODEL = arm_model("kr6_r900_sixx")
LIMITS = working_limits(MODEL)
START_DEG = (0.0, -90.0, 90.0, 0.0, 60.0, 0.0)
START = radians6(*START_DEG)
FAR = radians6(40, -60, 60, 30, 80, 90)
AXES = tuple(f"AK.A{k}" for k in range(1, 7))
SETTINGS = LinkSettings(
    host="127.0.0.1",
    port=1,
    parent_pid=1,
    mailbox_fd=0,
    event_fd=0,
    variant="kr6_r900_sixx",
    cycle_ms=4,
    sentype="KROSHU",
    send_tags=("DEF_AIPos",),
    receive_tags=("Stop", *AXES),
    axis_tags=AXES,
    stop_tag="Stop",
    silence_limit_s=0.25,
    heartbeat_limit_s=1.0,
    settle_tolerance_deg=0.0002,
    speed_fraction=0.12,
    real_time_priority=0,
)
RAMP_DOWN_SHARE = 1.3  # a stop within the jerk limit still gains speed until its acceleration is gone
NUMBERS = re.compile(rb'"(-?\d+\.\d{6})"')
WORKING_STEP_DEG = [degrees(v) * 0.004 for v in LIMITS.speed_rad_s]


class Cell:
    """A session and the arm that follows it exactly, cycle by cycle."""

    def __init__(self, **changes: Any) -> None:
        self.session = Session(replace(SETTINGS, **changes))
        self.now_ns = 1_000_000_000
        self.ipoc = 1000
        self.delay = 0
        self.beat = 1
        self.beats = True
        self.stop_word = 0
        self.commands = 0
        self.axes: JointVector = START_DEG
        self.follows = True
        self.sent: list[tuple[JointVector, int]] = []
        self.give(CommandKind.OPEN)

    def give(self, kind: CommandKind, plan: MotionPlan | None = None, stop_number: int | None = None) -> None:
        self.commands += 1
        seen = self.stop_word >> 3 if stop_number is None else stop_number
        self.pending: Command | None = Command(self.commands, kind, plan, seen)
        if not self.sent:
            self.session.take(self.pending)

    def stop(self, kind: StopOrder) -> None:
        self.stop_word = ((self.stop_word >> 3) + 1) * 8 + kind

    def cycle(self, lost: int = 0) -> bool:
        """One telegram; True when it was answered."""
        self.now_ns += 4_000_000 * (1 + lost)
        self.beat += self.beats
        self.ipoc += 4 * (1 + lost)
        telegram = Telegram(self.axes, self.delay, str(self.ipoc).encode())
        head = self.session.answer(telegram, Orders(self.beat, self.stop_word, self.commands), self.now_ns)
        if head is None:
            return False
        A1, A2, A3, A4, A5, A6 = (float(v) for v in NUMBERS.findall(head))
        corrections = (A1, A2, A3, A4, A5, A6)
        self.sent.append((corrections, int(head[head.index(b"<Stop>") + 6 : head.index(b"</Stop>")])))
        self.session.after_reply(self.pending)
        if self.follows:
            a, b, c, d, e, f = (s + v for s, v in zip(START_DEG, corrections, strict=True))
            self.axes = (a, b, c, d, e, f)
        return True

    def run(self, most: int = 3000) -> int:
        """Cycles until the motion's result is there."""
        for count in range(most):
            if self.session.result is not Result.RUNNING:
                return count
            self.cycle()
        raise AssertionError("no result")

    def smooth(self, share: float = 1.05) -> bool:
        """No step of a command beyond `share` of the working step, far from what a controller refuses."""
        steps = (
            (abs(y - x), limit)
            for (a, _), (b, _) in pairwise(self.sent)
            for x, y, limit in zip(a, b, WORKING_STEP_DEG, strict=True)
        )
        return all(step <= limit * share for step, limit in steps)


def _begun(cycles: int = 3, **changes: Any) -> Cell:
    cell = Cell(**changes)
    for _ in range(cycles):
        cell.cycle()
    return cell


def _moving(cycles: int = 120, target: JointVector = FAR) -> Cell:
    cell = _begun()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, target, LIMITS))
    for _ in range(cycles):
        cell.cycle()
    assert cell.session.moving
    return cell


def _result(cell: Cell) -> Result:
    return cell.session.result


def _phase(cell: Cell) -> Phase:
    return cell.session.phase


def _fault(cell: Cell) -> Fault:
    return cell.session.fault


def test_nothing_is_answered_before_a_session_is_open() -> None:
    session = Session(SETTINGS)
    assert session.answer(Telegram(START_DEG, 0, b"4"), Orders(1, 0, 0), 1) is None
    assert session.phase is Phase.IDLE


def test_the_first_correction_is_zero_whatever_the_pose() -> None:
    cell = Cell()
    cell.axes = (1.2345, -77.7777, 99.9999, -3.3333, 12.3456, 200.0001)
    cell.follows = False
    for _ in range(5):
        cell.cycle()
    assert {s for s, _ in cell.sent} == {(0.0,) * 6}
    assert cell.session.phase is Phase.RUNNING


def test_a_first_pose_outside_the_ranges_is_a_fault_and_still_gets_zero() -> None:
    cell = Cell()
    cell.axes = (0.0, 60.0, 0.0, 0.0, 0.0, 0.0)
    cell.follows = False
    cell.cycle()
    assert cell.session.fault is Fault.BASE
    assert cell.sent[-1][0] == (0.0,) * 6


def test_a_motion_ends_at_its_target_and_is_done_after_ten_settled_cycles() -> None:
    cell = _begun()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, FAR, LIMITS))
    cell.cycle()
    cycles = cell.run()
    assert cell.session.result is Result.DONE
    assert cell.session.sent_rad == FAR
    assert cell.smooth()
    last_change = max(k for k in range(1, len(cell.sent)) if cell.sent[k] != cell.sent[k - 1])
    assert len(cell.sent) - last_change >= 10
    assert cycles > 200


def test_a_motion_is_not_done_while_the_arm_is_off_by_more_than_the_tolerance() -> None:
    cell = _moving(cycles=1, target=radians6(0.5, -90, 90, 0, 60, 0))
    for _ in range(300):
        cell.cycle()
        cell.axes = (cell.axes[0] - 0.0003, *cell.axes[1:])
    assert _result(cell) is Result.RUNNING
    cell.cycle()
    cell.run(50)
    assert cell.session.result is Result.DONE


@settings(max_examples=40, deadline=None)
@given(
    cycles=st.integers(1, 260),
    kind=st.sampled_from([StopOrder.HOLD, StopOrder.PROTECTIVE, StopOrder.DRIVES_OFF]),
    line=st.booleans(),
)
def test_a_stop_in_any_cycle_is_smooth(cycles: int, kind: StopOrder, line: bool) -> None:
    cell = _begun()
    here = forward(MODEL, START)
    x, y, z = here.position_mm
    plan = (
        plan_line(MODEL, START, Pose((x - 40, y + 60, z - 40), here.rotation), LIMITS, (0.0, 0.0, 200.0))
        if line
        else plan_joint_move(MODEL, START, FAR, LIMITS)
    )
    cell.give(CommandKind.MOVE, plan)
    for _ in range(cycles):
        cell.cycle()
    cell.stop(kind)
    for _ in range(150):
        cell.cycle()
    assert not cell.session.moving
    assert cell.smooth()
    assert cell.session.violation is None
    expected = Phase.RUNNING if kind is StopOrder.HOLD else Phase.FAULT
    assert cell.session.phase is expected


def test_a_stop_acts_on_the_reply_to_the_very_next_telegram() -> None:
    one, other = _moving(), _moving()
    other.stop(StopOrder.HOLD)
    one.cycle()
    other.cycle()
    assert one.sent[:-1] == other.sent[:-1]
    assert one.sent[-1] != other.sent[-1]


def test_link_stop_ceases_replies_at_once() -> None:
    cell = _moving()
    cell.stop(StopOrder.LINK)
    assert not cell.cycle()
    assert cell.session.fault is Fault.LINK_STOP
    assert cell.session.phase is Phase.SILENT
    assert not cell.session.moving


def test_the_end_sends_stop_with_the_last_point() -> None:
    cell = _begun()
    cell.give(CommandKind.END)
    for _ in range(4):
        cell.cycle()
    assert _phase(cell) is Phase.ENDING
    assert cell.sent[-1] == ((0.0,) * 6, 1)
    cell.give(CommandKind.CLOSE)
    cell.cycle()
    assert cell.session.phase is Phase.IDLE
    assert not cell.cycle()


def test_the_end_waits_for_rest() -> None:
    cell = _moving()
    cell.give(CommandKind.END)
    cell.cycle()
    assert cell.session.phase is Phase.RUNNING
    assert cell.sent[-1][1] == 0


# Refusals


def test_a_motion_from_another_start_is_refused() -> None:
    cell = _begun()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, FAR, START, LIMITS))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_START
    assert not cell.session.moving


def test_a_motion_during_another_is_refused() -> None:
    cell = _moving()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, FAR, LIMITS))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_BUSY
    assert cell.session.moving


@pytest.mark.hazard(32)
def test_a_motion_planned_before_a_stop_is_refused() -> None:
    cell = _begun()
    cell.stop(StopOrder.HOLD)
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, FAR, LIMITS), stop_number=0)
    cell.cycle()
    assert cell.session.result is Result.REFUSED_STOP
    assert not cell.session.moving


def test_a_motion_with_impossible_numbers_is_refused() -> None:
    cell = _begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, FAR, PathLimits(1.0, -1.0, 1.0)))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_NUMBERS


@pytest.mark.hazard(32)
def test_a_motion_while_a_fault_is_latched_is_refused() -> None:
    cell = _begun()
    cell.stop(StopOrder.PROTECTIVE)
    cell.cycle()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, FAR, LIMITS))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_PHASE


# Monitor


@pytest.mark.parametrize(
    ("limits", "kind"),
    [
        (PathLimits(5.0, 5.0, 20.0), "step"),
        (PathLimits(1.0, 10.0, 100.0), "acceleration"),
        (PathLimits(0.5, 50.0, 5000.0), "jerk"),
    ],
)
def test_a_generator_that_asks_too_much_is_stopped_by_the_monitor(limits: PathLimits, kind: str) -> None:
    cell = _begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, FAR, limits))
    for _ in range(400):
        cell.cycle()
    assert cell.session.fault is Fault.MONITOR
    assert cell.session.violation is not None
    assert cell.session.violation.kind == kind
    assert not cell.session.moving
    assert cell.session.phase is Phase.FAULT
    assert cell.smooth(RAMP_DOWN_SHARE)


def test_a_path_that_leads_out_of_range_is_stopped_at_the_range() -> None:
    beyond = radians6(0, -90, 90, 0, 125, 0)
    cell = _begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, beyond, PathLimits(0.3, 1.0, 10.0)))
    for _ in range(1500):
        cell.cycle()
    assert cell.session.fault is Fault.MONITOR
    assert cell.session.violation is not None
    assert cell.session.violation.kind == "range"
    assert cell.session.sent_rad[4] <= MODEL.upper_rad[4] + radians(2.0)
    assert cell.smooth()


def test_a_line_without_a_solution_on_the_way_is_stopped_by_the_joints() -> None:
    here = forward(MODEL, START)
    away = Pose((here.position_mm[0] + 900, here.position_mm[1], here.position_mm[2]), here.rotation)
    cell = _begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, (*START[:5], 0.1), PathLimits(0.1, 0.1, 1.0), away))
    for _ in range(3000):
        cell.cycle()
        if cell.session.fault and not cell.session.moving:
            break
    assert cell.session.fault in (Fault.PATH, Fault.MONITOR)
    assert not cell.session.moving
    assert cell.smooth(RAMP_DOWN_SHARE)


@pytest.mark.hazard(38)
def test_an_axis_that_does_not_follow_stops_the_arm() -> None:
    cell = _moving()
    cell.follows = False
    for _ in range(300):
        cell.cycle()
    assert cell.session.fault is Fault.MONITOR
    assert cell.session.violation is not None
    assert cell.session.violation.kind == "following error"
    assert cell.smooth()


# Losses


def test_more_than_three_lost_cycles_are_degraded_and_a_clean_second_later_forgotten() -> None:
    losses = Losses(4)
    ipoc = 0
    for k in range(4):
        assert not losses.degraded
        ipoc += 8
        assert losses.count(ipoc, k) == (1 if k else 0)
    ipoc += 8
    losses.count(ipoc, 4)
    assert losses.degraded
    assert losses.lost == 4
    for _ in range(1000):
        ipoc += 4
        losses.count(ipoc, 4)
    assert not losses.degraded


def test_late_replies_count_as_well_even_without_a_gap() -> None:
    losses = Losses(4)
    for k in range(6):
        losses.count(4 * k, k)
    assert losses.late == 5
    assert losses.lost == 0
    assert losses.degraded


def test_the_time_stamp_may_wrap_and_may_repeat_but_not_run_back() -> None:
    losses = Losses(4)
    assert losses.count(2**32 - 4, -1) == 0
    assert losses.count(0, -1) == 0
    assert losses.count(0, -1) == -1
    assert losses.count(8, -1) == 1
    assert losses.count(4, -1) == -1  # overtaken on the way
    assert losses.count(12, -1) == 0
    assert losses.count(60_000, -1) is None
    assert losses.count(2**32 - 4000, -1) is None
    for stale in (8, 4, 8):
        assert losses.count(stale, -1) == -1
    assert losses.count(8, -1) is None  # and again and again: that is no accident


@pytest.mark.hazard(18)
def test_overtaken_and_repeated_telegrams_get_no_reply_and_disturb_no_motion() -> None:
    cell = _moving()
    for back in (4, 8, 12):
        cell.ipoc -= back
        assert not cell.cycle()
        cell.ipoc += back - 4
        assert cell.cycle()
    cell.run()
    assert cell.session.result is Result.DONE
    assert cell.session.fault is Fault.NONE
    assert cell.smooth()


@pytest.mark.hazard(18)
@pytest.mark.parametrize("stall_ms", [8, 20, 50, 100, 250, 400, 500])
def test_after_a_stall_of_the_host_the_motion_goes_on_smoothly_and_arrives(stall_ms: int) -> None:
    cell = _moving()
    assert cell.cycle(lost=stall_ms // 4)
    cell.run()
    assert cell.session.result is Result.DONE
    assert cell.session.fault is Fault.NONE
    assert cell.smooth()
    state = cell.session.state(real_time=False, locked=False)
    assert state.lost == stall_ms // 4


def test_a_repeated_telegram_gets_no_second_reply() -> None:
    cell = _begun()
    cell.ipoc -= 4
    assert not cell.cycle()


@pytest.mark.hazard(18)
def test_after_a_long_gap_the_held_point_is_sent_and_the_motion_begins_from_rest() -> None:
    cell = _moving()
    before = cell.sent[-1][0]
    cell.cycle(lost=6)
    assert cell.sent[-1][0] == before
    cell.cycle()
    assert max(abs(b - a) for a, b in zip(before, cell.sent[-1][0], strict=True)) < 1e-3
    cell.run()
    assert cell.session.result is Result.DONE
    assert cell.smooth()


@pytest.mark.hazard(34)
def test_telegrams_of_another_run_get_no_reply_and_latch_a_fault() -> None:
    cell = _moving()
    cell.ipoc = 12
    assert not cell.cycle()
    assert cell.session.fault is Fault.RESTARTED
    assert not cell.cycle()


@pytest.mark.hazard(34)
def test_when_only_another_sender_is_left_the_controller_was_started_again() -> None:
    cell = _moving()
    orders = Orders(cell.beat, 0, cell.commands)
    cell.session.met_foreign("10.0.0.3")
    cell.session.idle(orders, cell.now_ns + 240_000_000)
    assert _fault(cell) is Fault.NONE
    cell.session.idle(orders, cell.now_ns + 260_000_000)
    assert _fault(cell) is Fault.RESTARTED


def test_a_stranger_among_the_telegrams_changes_nothing() -> None:
    cell = _moving()
    cell.session.met_foreign("10.0.0.3")
    cell.run()
    assert cell.session.result is Result.DONE
    state = cell.session.state(real_time=False, locked=False)
    assert (state.foreign, state.foreign_host) == (1, "10.0.0.3")


# Silence and the parent


def test_silence_beyond_the_limit_is_latched_and_the_motion_forgotten() -> None:
    cell = _moving()
    orders = Orders(cell.beat, 0, cell.commands)
    cell.session.idle(orders, cell.now_ns + 240_000_000)
    assert _fault(cell) is Fault.NONE
    cell.session.idle(orders, cell.now_ns + 260_000_000)
    assert cell.session.fault is Fault.SILENCE
    assert not cell.session.moving
    before = cell.sent[-1][0]
    cell.cycle(lost=70)
    assert cell.sent[-1][0] == before


@pytest.mark.hazard(30)
def test_a_late_heartbeat_stops_the_arm_and_ends_the_program() -> None:
    cell = _moving(cycles=1)
    cell.beats = False
    for _ in range(600):
        cell.cycle()
    assert cell.session.fault is Fault.HEARTBEAT
    assert cell.session.phase is Phase.ENDING
    assert cell.sent[-1][1] == 1
    assert cell.smooth()


def test_a_heart_that_beats_now_and_then_keeps_the_session() -> None:
    cell = _begun()
    for k in range(1000):
        cell.beats = k % 200 == 0
        cell.cycle()
    assert cell.session.fault is Fault.NONE


@pytest.mark.hazard(30)
def test_without_its_parent_the_arm_stops_and_the_program_is_ended() -> None:
    cell = _moving()
    cell.session.parent_gone = True
    for _ in range(150):
        cell.cycle()
    assert cell.session.phase is Phase.ENDING
    assert not cell.session.moving
    assert cell.sent[-1][1] == 1
    assert cell.smooth()
