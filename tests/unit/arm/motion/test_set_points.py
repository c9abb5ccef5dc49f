"""Motion invariants: paths and limits are kept; a stop at any cycle is smooth and stays on the path."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from coded_errors import raises
from hypothesis import given, settings
from hypothesis import strategies as st
from monitored_motion import drive_monitored

from ronna_hw.arm.errors import MOTION_INVALID
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.monitor import Monitor, monitor_limits
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import LinePath, MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.progress import AxisState, Bounds, MotionProfiler
from ronna_hw.arm.motion.set_points import PathMotion, StopMotion, plan_halt, state_from_history
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.vectors import JointVector

MODEL = kr6_r900(SIXX)
LIMITS = working_limits(MODEL)
TO_THE_ENDS = replace(LIMITS, range_margin_rad=0.0)
CYCLE_S = 0.004
START = radians6(0, -90, 90, 0, 60, 0)
TOOL_MM = (10.0, 0.0, 200.0)

joint_vectors = st.tuples(
    *(st.floats(low, high) for low, high in zip(MODEL.lower_rad, MODEL.upper_rad, strict=True))
)


def _motion(plan: MotionPlan) -> PathMotion:
    return PathMotion(plan.path(MODEL), plan.start_rad, plan.limits, CYCLE_S)


def _run(motion: PathMotion, start: JointVector, stop_at: int | None = None) -> list[JointVector]:
    """All set-points sent; every one, and every stop that was ready beside it, passes the monitor."""
    monitor = Monitor(monitor_limits(MODEL, TO_THE_ENDS, CYCLE_S, start), start)
    sent = [start]
    while not motion.is_finished:
        prepared = motion.prepare()
        assert monitor.check(prepared.go_rad) is None
        assert monitor.check(prepared.stop_rad) is None
        if stop_at is not None and len(sent) > stop_at:
            motion.take_stop()
            sent.append(prepared.stop_rad)
        else:
            motion.take_go()
            sent.append(prepared.go_rad)
        monitor.sent(sent[-1])
        assert len(sent) < 20_000
    return sent


@settings(max_examples=12, deadline=None)
@given(start=joint_vectors, target=joint_vectors, stop_at=st.integers(1, 600))
def test_a_joint_move_stays_straight_in_joint_space_even_when_stopped(
    start: JointVector, target: JointVector, stop_at: int
) -> None:
    plan = plan_joint_move(MODEL, start, target, TO_THE_ENDS)
    if plan.is_standstill:
        return
    whole = _run(_motion(plan), start)
    assert whole[-1] == target
    longest = max(range(6), key=lambda i: abs(target[i] - start[i]))
    for joints in _run(_motion(plan), start, stop_at):
        s = (joints[longest] - start[longest]) / (target[longest] - start[longest])
        assert -1e-12 <= s <= 1 + 1e-12
        for i in range(6):
            assert joints[i] == pytest.approx(start[i] + s * (target[i] - start[i]), abs=1e-9)


@pytest.mark.parametrize("stop_at", [None, 1, 60, 250])
def test_the_tool_stays_on_its_line_even_when_stopped(stop_at: int | None) -> None:
    target = MODEL.forward(radians6(8, -82, 84, 5, 70, 20))
    plan = plan_line(MODEL, START, target, LIMITS, TOOL_MM)
    begin = MODEL.forward(START).apply(TOOL_MM)
    end = target.apply(TOOL_MM)
    length = math.dist(begin, end)
    previous = begin
    for joints in _run(_motion(plan), START, stop_at):
        tip = MODEL.forward(joints).apply(TOOL_MM)
        along = sum((t - b) * (e - b) for t, b, e in zip(tip, begin, end, strict=True)) / length
        assert math.dist(begin, tip) == pytest.approx(along, abs=1e-6)
        assert math.dist(previous, tip) <= LIMITS.line_speed_mm_s * CYCLE_S * (1 + 1e-6)
        previous = tip
    if stop_at is None:
        assert math.dist(previous, end) < 1e-6
        assert MODEL.forward(joints).angle_rad(target) < 1e-9
    else:
        assert math.dist(previous, end) > 1.0


def test_a_turn_about_the_tool_tip_keeps_the_tip_in_place() -> None:
    flange = MODEL.forward(START)
    tip = flange.apply(TOOL_MM)
    turned = flange.compose(Pose.from_kuka(0, 0, 0, 20, 10, 0))
    offset = Pose((0.0, 0.0, 0.0), turned.rotation).apply(TOOL_MM)
    target = Pose((tip[0] - offset[0], tip[1] - offset[1], tip[2] - offset[2]), turned.rotation)
    plan = plan_line(MODEL, START, target, LIMITS, TOOL_MM)
    for joints in _run(_motion(plan), START):
        assert math.dist(MODEL.forward(joints).apply(TOOL_MM), tip) < 1e-6
    line = LinePath(MODEL, START, target, TOOL_MM)
    assert line.flange(0.5).angle_rad(flange) == pytest.approx(line.angle_rad / 2, abs=1e-9)


def test_reducing_the_speed_during_a_motion_keeps_the_path_and_the_end() -> None:
    target = radians6(40, -70, 70, 20, 50, 30)
    plan = plan_joint_move(MODEL, START, target, LIMITS)
    motion = _motion(plan)
    monitor = Monitor(monitor_limits(MODEL, LIMITS, CYCLE_S, START), START)
    cycles = drive_monitored(motion, monitor, slower_after=100)
    assert monitor.last_rad == target
    assert isinstance(cycles, int)
    assert cycles > 2 * len(_run(_motion(plan), START))


@pytest.mark.parametrize("one_back", [False, True])
@pytest.mark.parametrize("stopping", [False, True])
def test_after_an_interruption_the_motion_continues_from_rest(stopping: bool, one_back: bool) -> None:
    target = radians6(40, -70, 70, 20, 50, 30)
    motion = _motion(plan_joint_move(MODEL, START, target, LIMITS))
    before = here = START
    for _ in range(150):
        before, here = here, motion.prepare().go_rad
        motion.take_go()
    if stopping:
        before, here = here, motion.prepare().stop_rad
        motion.take_stop()
    motion.restart_from_rest(one_back=one_back)
    here = before if one_back else here
    monitor = Monitor(monitor_limits(MODEL, LIMITS, CYCLE_S, START), START)
    for _ in range(3):
        monitor.sent(here)
    assert isinstance(drive_monitored(motion, monitor), int)
    assert monitor.last_rad == (here if stopping else target)
    assert motion.was_stopped_early is stopping


@settings(max_examples=40, deadline=None)
@given(
    velocity=st.tuples(*(st.floats(-2, 2) for _ in range(6))),
    acceleration=st.tuples(*(st.floats(-20, 20) for _ in range(6))),
)
def test_a_joint_stop_comes_to_rest_from_any_state(
    velocity: tuple[float, ...], acceleration: tuple[float, ...]
) -> None:
    motion = StopMotion(AxisState(list(START), list(velocity), list(acceleration)), LIMITS, CYCLE_S)
    points = [motion.prepare().go_rad]
    while not motion.is_finished:
        motion.take_go()
        points.append(motion.prepare().go_rad)
    assert len(points) * CYCLE_S < 20.0
    assert points[-1] == pytest.approx(motion.prepare().go_rad)


def test_a_profile_holds_its_end_positions() -> None:
    bounds = Bounds([1.0], [2.0], [10.0])
    profile = MotionProfiler(1).move(AxisState([0.0], [0.5], [0.0]), [0.05], bounds)
    assert profile.sample(-5.0).position == [0.0]
    assert profile.sample(1e6).position[0] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("start", "target", "bounds"),
    [
        (AxisState.resting([0.0]), [1.0, 2.0], Bounds([1.0], [1.0], [1.0])),
        (AxisState.resting([0.0, 0.0]), [1.0], Bounds([1.0], [1.0], [1.0])),
        (AxisState.resting([0.0]), [math.nan], Bounds([1.0], [1.0], [1.0])),
        (AxisState.resting([0.0]), [1.0], Bounds([0.0], [1.0], [1.0])),
        (AxisState.resting([0.0]), [1.0], Bounds([1.0], [1.0], [-1.0])),
    ],
)
def test_invalid_numbers_for_a_profile_give_one_typed_error(
    start: AxisState, target: list[float], bounds: Bounds
) -> None:
    with raises(MOTION_INVALID) as caught:
        MotionProfiler(1).move(start, target, bounds)
    assert caught.value.code == "ARM-006"
    assert "\n" not in str(caught.value)


LINE = plan_line(MODEL, START, MODEL.forward(radians6(8, -82, 84, 5, 70, 20)), LIMITS, TOOL_MM)
JOINT_MOVE = plan_joint_move(MODEL, START, radians6(40, -70, 70, 20, 50, 30), LIMITS)
BESIDE_THE_LINE_MM = 0.02  # the third order of some millimetres of stopping distance


def _interrupted(plan: MotionPlan, cycles: int) -> tuple[list[JointVector], list[JointVector]]:
    """The set-points of a motion up to a cycle, and those of the stop that then knows only these."""
    motion = PathMotion(plan.path(MODEL), plan.start_rad, plan.limits, CYCLE_S)
    sent = [plan.start_rad] * 4
    for _ in range(cycles):
        sent.append(motion.prepare().go_rad)
        motion.take_go()
    stop = StopMotion(state_from_history((sent[-1], sent[-2], sent[-3], sent[-4]), CYCLE_S), LIMITS, CYCLE_S)
    assert stop._halt is not None
    stopped = sent[-2:]
    while not stop.is_finished:
        stopped.append(stop.prepare().stop_rad)
        stop.take_stop()
    return sent, stopped


@pytest.mark.hazard(21)
@pytest.mark.parametrize("cycles", [10, 40, 120, 300])
def test_the_stopping_tool_continues_along_its_line_and_never_faster(cycles: int) -> None:
    _, stopped = _interrupted(LINE, cycles)
    begin, end = MODEL.forward(START).apply(TOOL_MM), MODEL.forward(LINE.target_rad).apply(TOOL_MM)
    tips = [MODEL.forward(joints).apply(TOOL_MM) for joints in stopped]
    for tip in tips:
        along = sum((t - b) * (e - b) for t, b, e in zip(tip, begin, end, strict=True)) / math.dist(
            begin, end
        )
        beside = math.sqrt(max(math.dist(begin, tip) ** 2 - along**2, 0.0))
        assert beside < BESIDE_THE_LINE_MM
    speeds = [math.dist(a, b) / CYCLE_S for a, b in pairwise(tips)]
    assert max(speeds) <= max(speeds[0], LIMITS.line_speed_mm_s) * (1 + 1e-4)
    assert speeds[-1] < 1.0


@pytest.mark.parametrize("cycles", [5, 100, 200])
def test_a_stopping_joint_move_stays_straight_in_joint_space(cycles: int) -> None:
    _, stopped = _interrupted(JOINT_MOVE, cycles)
    change = [b - a for a, b in zip(JOINT_MOVE.start_rad, JOINT_MOVE.target_rad, strict=True)]
    for joints in stopped:
        s = (joints[0] - START[0]) / change[0]
        assert joints == pytest.approx([a + s * d for a, d in zip(START, change, strict=True)], abs=1e-9)


@pytest.mark.parametrize("plan", [LINE, JOINT_MOVE], ids=["line", "joint move"])
def test_a_stop_takes_little_longer_than_joints_braking_independently(plan: MotionPlan) -> None:
    sent, stopped = _interrupted(plan, 150)
    moving = state_from_history((sent[-1], sent[-2], sent[-3], sent[-4]), CYCLE_S)
    alone_s = max(
        abs(v) / a + a / j
        for v, a, j in zip(moving.velocity, LIMITS.acceleration_rad_s2, LIMITS.jerk_rad_s3, strict=True)
    )
    assert (len(stopped) - 2) * CYCLE_S < 1.5 * alone_s


def test_at_rest_there_is_nothing_to_stop() -> None:
    assert plan_halt(AxisState.resting(list(START)), LIMITS) is None
    assert StopMotion(AxisState.resting(list(START)), LIMITS, CYCLE_S).is_finished


def test_joints_that_cannot_brake_together_brake_independently() -> None:
    turning_hard = AxisState(list(START), [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 20.0, 0.0, 0.0, 0.0, 0.0])
    assert plan_halt(turning_hard, LIMITS) is None
    stop = StopMotion(turning_hard, LIMITS, CYCLE_S)
    assert stop._halt is None
    while not stop.is_finished:
        stop.take_stop()
    assert stop.prepare().go_rad == pytest.approx(stop.predict_stop()[1])
