"""Cost of one set-point, including the check of continuing and stopping, against a bare generator step.

Monitored: with a head, clamp, table and spheres around, the guide on the flange and the speed zone active.
"""

from __future__ import annotations

from math import inf

from ruckig import InputParameter, OutputParameter, Result, Ruckig

from benchmarks.figures import Figure, compare_samples, measure_cpu_s, run_contest
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.arm_stream.records import Choice
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.preview import with_speed_steps

CYCLE_S = 0.004
ROUNDS = 20
CYCLES_PER_ROUND = 150  # fewer than any of the motions takes
START = radians6(0, -90, 90, 0, 60, 0)
AWAY = radians6(40, -70, 70, 20, 40, 30)
LINE_MM = 150.0
TOOL_MM = (0.0, 0.0, 150.0)
GOAL_US = 25.0  # generator, inverse kinematics, monitor and distances together
HEAD_BELOW_MM = 180.0
HEAD_SEMI_AXES_MM = (75.0, 95.0, 90.0)
SPHERES_MM = ((-40.0, -30.0), (40.0, -30.0), (0.0, 40.0), (-50.0, 20.0), (50.0, 20.0))
BARE = "bare 6-axis step of ruckig"


def measure(smallest: bool = False) -> list[Figure]:
    model = kr6_r900(SIXX)
    limits = working_limits(model)
    here = model.forward(START)
    x, y, z = here.position_mm
    line = plan_line(model, START, Pose((x, y + LINE_MM, z), here.rotation), limits, TOOL_MM)
    move = plan_joint_move(model, START, AWAY, limits)
    around = _surroundings(here)
    samples = run_contest(
        {
            "joint move": lambda: _measure_cycle_s(move),
            "straight line": lambda: _measure_cycle_s(line),
            "joint move, watched": lambda: _measure_cycle_s(_slow_down(move, around), around),
            "straight line, watched": lambda: _measure_cycle_s(_slow_down(line, around), around),
            "at rest": lambda: _measure_cycle_s(None),
            BARE: _measure_bare_s,
        },
        1 if smallest else ROUNDS,
    )
    figures = compare_samples("CPU per set-point, go and stop judged", "µs", samples, BARE, scale=1e6)
    return [figure.at_most(GOAL_US) if figure.who.endswith("watched") else figure for figure in figures]


def _surroundings(flange: Pose) -> Surroundings:
    """Return the default surroundings, with a head a hand's breadth below the needle."""
    cell = CollisionConfig()
    tip = flange.apply(TOOL_MM)
    head = Pose.from_kuka(tip[0], tip[1], tip[2] - HEAD_BELOW_MM, 90.0, 0.0, 30.0)
    spheres = tuple((tip[0] + x, tip[1] + y, tip[2] - HEAD_BELOW_MM + 105.0) for x, y in SPHERES_MM)
    return cell.build_surroundings(cell.guide, Pose(TOOL_MM), head, HEAD_SEMI_AXES_MM, spheres)


def _slow_down(plan: MotionPlan, around: Surroundings) -> MotionPlan:
    return with_speed_steps(plan, sweep_path(kr6_r900(SIXX), plan, around), inf)


def _measure_cycle_s(plan: MotionPlan | None, around: Surroundings | None = None) -> float:
    model = kr6_r900(SIXX)
    points = SetPoints(model, working_limits(model), CYCLE_S, START)
    if plan is not None:
        points.start(plan, 1.0, around)
    points.prepare()

    def cycle() -> None:
        points.commit(Choice.GO)
        points.prepare()

    spent = measure_cpu_s(cycle, CYCLES_PER_ROUND)
    if plan is not None and not (points.moving and points.violation is None):
        raise RuntimeError("the motion ended, or tripped, while it was measured")
    return spent


def _measure_bare_s() -> float:
    model = kr6_r900(SIXX)
    limits = working_limits(model)
    generator, target, found = Ruckig(6, CYCLE_S), InputParameter(6), OutputParameter(6)
    target.current_position, target.target_position = list(START), list(AWAY)
    target.current_velocity = target.current_acceleration = [0.0] * 6
    target.max_velocity = list(limits.speed_rad_s)
    target.max_acceleration = list(limits.acceleration_rad_s2)
    target.max_jerk = list(limits.jerk_rad_s3)
    results: list[Result] = []

    def cycle() -> None:
        results.append(generator.update(target, found))
        found.pass_to_input(target)

    spent = measure_cpu_s(cycle, CYCLES_PER_ROUND)
    if results[-1] is not Result.Working:
        raise RuntimeError("the bare motion ended while it was measured")
    return spent
