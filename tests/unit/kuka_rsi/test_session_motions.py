"""A session from its first telegram to its end: motions, stops, and what is refused."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_cell import (
    FAR,
    LIMITS,
    MODEL,
    SETTINGS,
    START,
    START_DEG,
    Cell,
    begun,
    moving,
    phase_of,
    result_of,
)

from drivers.kuka_rsi.realtime.link_state import (
    CommandKind,
    Fault,
    Orders,
    Phase,
    Result,
    StopOrder,
)
from drivers.kuka_rsi.realtime.responder import Session
from drivers.kuka_rsi.realtime.telegram import Telegram
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.progress import PathLimits
from ronna_hw.arm.pose import Pose


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
    cell = begun()
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
    cell = moving(cycles=1, target=radians6(0.5, -90, 90, 0, 60, 0))
    for _ in range(300):
        cell.cycle()
        cell.axes = (cell.axes[0] - 0.0003, *cell.axes[1:])
    assert result_of(cell) is Result.RUNNING
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
    cell = begun()
    here = MODEL.forward(START)
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
    one, other = moving(), moving()
    other.stop(StopOrder.HOLD)
    one.cycle()
    other.cycle()
    assert one.sent[:-1] == other.sent[:-1]
    assert one.sent[-1] != other.sent[-1]


def test_link_stop_ceases_replies_at_once() -> None:
    cell = moving()
    cell.stop(StopOrder.LINK)
    assert not cell.cycle()
    assert cell.session.fault is Fault.LINK_STOP
    assert cell.session.phase is Phase.SILENT
    assert not cell.session.moving


def test_the_end_sends_stop_with_the_last_point() -> None:
    cell = begun()
    cell.give(CommandKind.END)
    for _ in range(4):
        cell.cycle()
    assert phase_of(cell) is Phase.ENDING
    assert cell.sent[-1] == ((0.0,) * 6, 1)
    cell.give(CommandKind.CLOSE)
    cell.cycle()
    assert cell.session.phase is Phase.IDLE
    assert not cell.cycle()


def test_the_end_waits_for_rest() -> None:
    cell = moving()
    cell.give(CommandKind.END)
    cell.cycle()
    assert cell.session.phase is Phase.RUNNING
    assert cell.sent[-1][1] == 0


def test_a_motion_from_another_start_is_refused() -> None:
    cell = begun()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, FAR, START, LIMITS))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_START
    assert not cell.session.moving


def test_a_motion_during_another_is_refused() -> None:
    cell = moving()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, FAR, LIMITS))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_BUSY
    assert cell.session.moving


@pytest.mark.hazard(32)
def test_a_motion_planned_before_a_stop_is_refused() -> None:
    cell = begun()
    cell.stop(StopOrder.HOLD)
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, FAR, LIMITS), stop_number=0)
    cell.cycle()
    assert cell.session.result is Result.REFUSED_STOP
    assert not cell.session.moving


def test_a_motion_with_impossible_numbers_is_refused() -> None:
    cell = begun()
    cell.give(CommandKind.MOVE, MotionPlan(START, FAR, PathLimits(1.0, -1.0, 1.0)))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_NUMBERS


@pytest.mark.hazard(32)
def test_a_motion_while_a_fault_is_latched_is_refused() -> None:
    cell = begun()
    cell.stop(StopOrder.PROTECTIVE)
    cell.cycle()
    cell.give(CommandKind.MOVE, plan_joint_move(MODEL, START, FAR, LIMITS))
    cell.cycle()
    assert cell.session.result is Result.REFUSED_PHASE
