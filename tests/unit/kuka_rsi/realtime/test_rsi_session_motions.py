"""Sessions from first telegram to end: motions, stops, and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rsi_stand import (
    FAR,
    LIMITS,
    MODEL,
    START,
    RsiStand,
    begun,
    moving,
)

from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.progress import PathLimits
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.arm_stream.records import (
    CloseStream,
    EndStream,
    LinkFault,
    MotionResult,
    Move,
    StopOrder,
    StreamPhase,
)


def test_the_first_correction_is_zero_whatever_the_pose() -> None:
    stand = RsiStand()
    stand.axes = (1.2345, -77.7777, 99.9999, -3.3333, 12.3456, 200.0001)
    stand.follows = False
    stand.cycles(5)
    assert {s for s, _ in stand.sent} == {(0.0,) * 6}
    assert stand.session.phase is StreamPhase.RUNNING


def test_a_first_pose_out_of_range_latches_a_fault_and_still_gets_a_zero_correction() -> None:
    stand = RsiStand()
    stand.axes = (0.0, 60.0, 0.0, 0.0, 0.0, 0.0)
    stand.follows = False
    stand.cycle()
    assert stand.session.fault is LinkFault.BASE
    assert stand.sent[-1][0] == (0.0,) * 6


def test_a_motion_ends_at_its_target_and_is_done_after_ten_settled_cycles() -> None:
    stand = begun()
    stand.give(Move(plan_joint_move(MODEL, START, FAR, LIMITS)))
    stand.cycle()
    cycles = stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.session.sent_rad == FAR
    assert stand.smooth()
    last_change = max(k for k in range(1, len(stand.sent)) if stand.sent[k] != stand.sent[k - 1])
    assert len(stand.sent) - last_change >= 10
    assert cycles > 200


def test_a_motion_that_need_not_settle_ends_with_its_last_set_point_and_the_next_one_follows_smoothly() -> (
    None
):
    stand = begun()
    stand.give(Move(plan_joint_move(MODEL, START, FAR, LIMITS), settles=False))
    stand.cycle()
    stand.run()
    assert stand.session.result is MotionResult.DONE
    at_the_end = len(stand.sent)
    assert stand.sent[at_the_end - 2] != stand.sent[at_the_end - 1]
    stand.give(Move(plan_joint_move(MODEL, FAR, START, LIMITS)))
    stand.cycle()
    stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.session.sent_rad == START
    assert stand.smooth()
    assert stand.session.violation is None


def test_a_motion_that_need_not_settle_is_stopped_like_any_other() -> None:
    stand = begun()
    stand.give(Move(plan_joint_move(MODEL, START, FAR, LIMITS), settles=False))
    stand.cycles(60)
    stand.stop(StopOrder.HOLD)
    stand.run()
    assert stand.session.result is MotionResult.STOPPED


def test_a_motion_is_not_done_while_the_arm_is_off_target_by_more_than_the_tolerance() -> None:
    stand = moving(cycles=1, target=radians6(0.5, -90, 90, 0, 60, 0))
    for _ in range(300):
        stand.cycle()
        stand.axes = (stand.axes[0] - 0.0003, *stand.axes[1:])
    assert stand.session.result is MotionResult.RUNNING
    stand.cycle()
    stand.run(50)
    assert stand.session.result is MotionResult.DONE


@settings(max_examples=40, deadline=None)
@given(
    cycles=st.integers(1, 260),
    kind=st.sampled_from([StopOrder.HOLD, StopOrder.PROTECTIVE, StopOrder.DRIVES_OFF]),
    line=st.booleans(),
)
def test_a_stop_in_any_cycle_is_smooth_and_ends_at_rest(cycles: int, kind: StopOrder, line: bool) -> None:
    stand = begun()
    here = MODEL.forward(START)
    x, y, z = here.position_mm
    plan = (
        plan_line(MODEL, START, Pose((x - 40, y + 60, z - 40), here.rotation), LIMITS, (0.0, 0.0, 200.0))
        if line
        else plan_joint_move(MODEL, START, FAR, LIMITS)
    )
    stand.give(Move(plan))
    stand.cycles(cycles)
    stand.stop(kind)
    stand.cycles(150)
    assert not stand.session.moving
    assert stand.smooth()
    assert stand.session.violation is None
    expected = StreamPhase.RUNNING if kind is StopOrder.HOLD else StreamPhase.FAULT
    assert stand.session.phase is expected


def test_a_link_stop_ceases_replies_at_once() -> None:
    stand = moving()
    stand.stop(StopOrder.LINK)
    assert not stand.cycle()
    assert stand.session.fault is LinkFault.LINK_STOP
    assert stand.session.phase is StreamPhase.SILENT
    assert not stand.session.moving


def test_ending_the_session_sends_stop_with_the_last_point() -> None:
    stand = begun()
    stand.give(EndStream())
    stand.cycles(4)
    assert stand.session.phase is StreamPhase.ENDING
    assert stand.sent[-1] == ((0.0,) * 6, 1)
    stand.give(CloseStream())
    stand.cycle()
    assert stand.session.phase is StreamPhase.IDLE
    assert not stand.cycle()


def test_the_session_ends_only_after_its_motion() -> None:
    stand = moving()
    stand.give(EndStream())
    stand.run()
    assert stand.session.phase is StreamPhase.RUNNING
    assert {stop for _, stop in stand.sent} == {0}
    stand.give(EndStream())
    stand.cycle()
    stand.cycle()
    assert stand.session.phase is StreamPhase.ENDING
    assert stand.sent[-1][1] == 1


DIRECT = plan_joint_move(MODEL, START, FAR, LIMITS)


def stopped(kind: StopOrder, cycles: int) -> RsiStand:
    stand = begun()
    stand.stop(kind)
    stand.cycles(cycles)
    return stand


@pytest.mark.parametrize(
    ("make_stand", "plan", "result"),
    [
        pytest.param(
            begun, plan_joint_move(MODEL, FAR, START, LIMITS), MotionResult.REFUSED_START, id="start"
        ),
        pytest.param(moving, DIRECT, MotionResult.REFUSED_BUSY, id="busy"),
        pytest.param(
            begun, MotionPlan(START, FAR, PathLimits(1, -1, 1)), MotionResult.REFUSED_NUMBERS, id="limits"
        ),
        pytest.param(
            lambda: stopped(StopOrder.HOLD, 0),
            DIRECT,
            MotionResult.REFUSED_STOP,
            id="planned before a stop",
            marks=pytest.mark.hazard(32),
        ),
        pytest.param(
            lambda: stopped(StopOrder.PROTECTIVE, 1),
            DIRECT,
            MotionResult.REFUSED_PHASE,
            id="fault",
            marks=pytest.mark.hazard(32),
        ),
    ],
)
def test_a_motion_that_must_not_start_is_refused(
    make_stand: Callable[[], RsiStand], plan: MotionPlan, result: MotionResult
) -> None:
    stand = make_stand()
    was_moving = stand.session.moving
    stand.give(Move(plan), stop_number=0)
    stand.cycle()
    assert stand.session.result is result
    assert stand.session.moving is was_moving
