"""A path-independent stop: it continues along the current path, joints together, the tool never faster."""

import math
from itertools import pairwise

import pytest

from ronna_hw.arm.kr6_r900 import ArmVariant, kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.progress import State
from ronna_hw.arm.motion.set_points import PathMotion, StopMotion, halt, state_from_history
from ronna_hw.arm.pose import radians6
from ronna_hw.devices.readings import JointVector

MODEL = kr6_r900(ArmVariant.SIXX)
LIMITS = working_limits(MODEL)
CYCLE_S = 0.004
START = radians6(0, -90, 90, 0, 60, 0)
TOOL_MM = (10.0, 0.0, 200.0)
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
    while not stop.finished:
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
    assert halt(State.resting(list(START)), LIMITS) is None
    assert StopMotion(State.resting(list(START)), LIMITS, CYCLE_S).finished


def test_joints_that_cannot_brake_together_brake_independently() -> None:
    turning_hard = State(list(START), [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 20.0, 0.0, 0.0, 0.0, 0.0])
    assert halt(turning_hard, LIMITS) is None
    stop = StopMotion(turning_hard, LIMITS, CYCLE_S)
    assert stop._halt is None
    while not stop.finished:
        stop.take_stop()
    assert stop.prepare().go_rad == pytest.approx(stop.predicted_stop()[1])
