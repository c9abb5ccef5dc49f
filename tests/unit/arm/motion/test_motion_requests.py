"""Random motion requests, interruptions and stops: no commanded set-point breaks a limit or jumps.

Judged is only what would be sent: a list of joint vectors, one per cycle, and what was promised before.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field
from math import radians

import numpy as np
import pytest

from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.live_watch import LiveWatch
from ronna_hw.arm.clearance.sweep import moving_ends, sweep, sweep_path
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.monitor import Monitor, monitor_limits
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.set_points import PathMotion, StopMotion, state_from_history
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.errors import LimitError
from ronna_hw.preview import with_speed_steps
from ronna_hw.vectors import JointVector

CYCLE_S = 0.004
MODEL = kr6_r900(SIXX)
CELL = CollisionConfig()
TOOL = Pose((220.0, 0.0, 60.0))
HEAD_SEMI_AXES_MM = (75.0, 95.0, 90.0)
WITH_REDUCED_SPEED = (True, False, False)
TOLERANCE = 1.0 + 1e-6  # rounding
CLEARANCE_TOLERANCE_MM = 0.3  # half of the finest motion between two checks of a path
UNTRUSTED_PATHS = 0.4  # share of the interruptions that do not trust the path


@dataclass
class Driven:
    """Outcome of one request: the points sent, or the code it was refused with."""

    refused: str = ""
    sent: list[JointVector] = field(default_factory=list)
    limits: MotionLimits | None = None
    surroundings: Surroundings | None = None
    plan: MotionPlan | None = None
    stop_cycles: int = 0  # that the stop took, counted
    stop_predicted_s: float = 0.0
    rest_predicted_rad: JointVector | None = None
    trusted_path: bool = True
    left_its_way: bool = False  # each joint stopped by itself
    tripped: str = ""  # what the monitor said


def drive(seed: int) -> Driven:
    """One random request in a random room, perhaps interrupted, perhaps stopped."""
    rng = random.Random(seed)
    start = _somewhere(rng)
    surroundings = _room(rng, start)
    limits = working_limits(MODEL).slowed(rng.choice((1.0, 1.0, 0.3)))
    if rng.choice(WITH_REDUCED_SPEED):
        limits = limits.with_reduced_speed(MODEL)
    found = Driven(limits=limits, surroundings=surroundings)
    try:
        plan = _request(rng, start, limits)
        path = sweep_path(MODEL, plan, surroundings)
        path.require()
    except LimitError as error:
        found.refused = error.code
        return found
    found.plan = plan = with_speed_steps(plan, path, limits.body_speed_mm_s)
    if plan.is_standstill:
        found.sent = [start]
        return found
    _follow(rng, found, plan, start)
    return found


def _follow(rng: random.Random, found: Driven, plan: MotionPlan, start: JointVector) -> None:
    limits, surroundings = found.limits, found.surroundings
    assert limits is not None
    assert surroundings is not None
    monitor = Monitor(monitor_limits(MODEL, limits, CYCLE_S, start), start)
    monitor.watch(LiveWatch(Bodies(MODEL, surroundings), CYCLE_S, start, limits.body_speed_mm_s))
    motion: PathMotion | StopMotion = PathMotion(
        plan.path(MODEL), start, plan.limits, CYCLE_S, plan.speed_steps
    )
    stop_at = rng.randint(0, 500) if rng.random() < 0.5 else -1
    slow_at = rng.randint(0, 500) if rng.random() < 0.3 else -1
    found.sent = [start]
    cycle = 0
    while not motion.is_finished:
        prepared = motion.prepare()
        if cycle == stop_at:
            found.trusted_path = rng.random() >= UNTRUSTED_PATHS
            if not found.trusted_path:
                motion = StopMotion(state_from_history(monitor.history_rad, CYCLE_S), limits, CYCLE_S)
                found.left_its_way = motion._halt is None and monitor.last_rad != start
                prepared = motion.prepare()
            found.stop_predicted_s, found.rest_predicted_rad = motion.predict_stop()
        stopping = 0 <= stop_at <= cycle
        point = prepared.stop_rad if stopping else prepared.go_rad
        violation = monitor.check(point)
        if violation is not None:
            found.tripped = found.tripped or str(violation)
        if stopping:
            motion.take_stop()
            found.stop_cycles += 1
        else:
            motion.take_go()
        monitor.sent(point)
        found.sent.append(point)
        if cycle == slow_at and isinstance(motion, PathMotion):
            motion.limit_speed(rng.choice((0.5, 0.25)))
        cycle += 1


def _room(rng: random.Random, start: JointVector) -> Surroundings:
    """A head somewhere about the tool, turned anyhow."""
    x, y, z = MODEL.forward(start).apply(TOOL.position_mm)
    angles = (rng.uniform(-180, 180), rng.uniform(-60, 60), rng.uniform(-180, 180))
    head = Pose.from_kuka(
        x + rng.uniform(-150, 250), y + rng.gauss(0, 150), z - rng.uniform(60, 350), *angles
    )
    tool = CELL.guide if rng.random() < 0.5 else CELL.stereo_head
    return CELL.build_surroundings(tool, TOOL, head, HEAD_SEMI_AXES_MM)


def _somewhere(rng: random.Random) -> JointVector:
    return radians6(
        rng.uniform(-60, 60),
        rng.uniform(-115, -55),
        rng.uniform(60, 115),
        rng.uniform(-50, 50),
        rng.uniform(25, 95),
        rng.uniform(100, 260),
    )


def _request(rng: random.Random, start: JointVector, limits: MotionLimits) -> MotionPlan:
    kind = rng.random()
    if kind < 0.4:
        target = _somewhere(rng) if rng.random() < 0.5 else _beside(rng, start)
        return plan_joint_move(MODEL, start, target, limits)
    if kind < 0.7:
        flange = MODEL.forward(start)
        x, y, z = flange.position_mm
        turned = flange.compose(Pose.from_kuka(0, 0, 0, *(rng.gauss(0, 12) for _ in range(3))))
        goal = Pose((x + rng.gauss(0, 60), y + rng.gauss(0, 60), z + rng.gauss(0, 60)), turned.rotation)
        return plan_line(MODEL, start, goal, limits, TOOL.position_mm)
    tool = MODEL.forward(start).compose(TOOL)
    along = Pose(tool.apply((0.0, 0.0, rng.uniform(-120, 120))), tool.rotation)
    return plan_line(MODEL, start, along.compose(TOOL.inverse()), limits, TOOL.position_mm)


def _beside(rng: random.Random, start: JointVector) -> JointVector:
    A1, A2, A3, A4, A5, A6 = (angle + radians(rng.gauss(0, 10)) for angle in start)
    return (A1, A2, A3, A4, A5, A6)


def faults_of(driven: Driven, every: int = 1) -> list[str]:
    """Everything that is wrong with what would have been sent; empty when nothing is.

    `every` so many set-points the distances are measured, which is what takes the time.
    """
    limits, surroundings, plan = driven.limits, driven.surroundings, driven.plan
    assert limits is not None
    assert surroundings is not None
    assert plan is not None
    found = [f"monitor: {driven.tripped}"] if driven.tripped else []
    points = np.array(driven.sent)
    if (points < np.array(MODEL.lower_rad)).any() or (points > np.array(MODEL.upper_rad)).any():
        found.append("range")
    # Before the first point and after the last one the arm rests.
    rested = np.concatenate([points[:1]] * 3 + [points] + [points[-1:]] * 3)
    steps = np.diff(rested, axis=0)
    differences = (("speed", steps, limits.speed_rad_s),)
    for order, (name, most) in enumerate(
        (("acceleration", limits.acceleration_rad_s2), ("jerk", limits.jerk_rad_s3)), start=2
    ):
        differences += ((name, np.diff(rested, order, axis=0), most),)
    for order, (name, values, most) in enumerate(differences, start=1):
        share = float((np.abs(values) / CYCLE_S**order / np.array(most)).max())
        if share > TOLERANCE:
            found.append(f"{name} {share:.4f}")
    return found + _stop_faults(driven) + _room_faults(driven, points, every)


def _stop_faults(driven: Driven) -> list[str]:
    if driven.rest_predicted_rad is None:
        return []
    found = ["the stop left the way of the arm"] if driven.left_its_way else []
    if (driven.stop_cycles - 1) * CYCLE_S > driven.stop_predicted_s + 1e-9:
        found.append(f"the stop took {driven.stop_cycles} cycles, not {driven.stop_predicted_s:.4f} s")
    apart = max(abs(x - y) for x, y in zip(driven.sent[-1], driven.rest_predicted_rad, strict=True))
    if apart > 1e-6:
        found.append(f"the stop ended {apart:.2e} rad beside its prediction")
    return found


def _room_faults(driven: Driven, points: np.ndarray, every: int) -> list[str]:
    surroundings = driven.surroundings
    assert surroundings is not None
    looked_at = np.unique(np.append(np.arange(0, len(points), every), len(points) - 1))
    swept = sweep(Bodies(MODEL, surroundings), points[looked_at])
    found = []
    floors = np.minimum(surroundings.margin_mm, swept.gaps_mm[0] - 0.05)
    lacking = float((floors - swept.gaps_mm).max())
    if lacking > CLEARANCE_TOLERANCE_MM:
        found.append(f"clearance lacks {lacking:.2f} mm")
    if len(points) > 1:
        ends = moving_ends(Bodies(MODEL, surroundings), points)
        moved = np.linalg.norm(np.diff(ends, axis=0), axis=3).max(axis=(1, 2)) / CYCLE_S
        caps = np.array([surroundings.cap_mm_s(distance) for distance in swept.to_head_mm.tolist()])
        # The step into each place that was looked at, and the one out of it.
        shares = np.maximum(np.append(0.0, moved)[looked_at] / caps, np.append(moved, 0.0)[looked_at] / caps)
        worst = float(shares.max())
        if worst > TOLERANCE:
            found.append(f"zone speed {worst:.4f}")
    return found


BATCH = 50
PAST_THE_HEAD = (66, 93, 103)  # requests that must be much slower on a part of their way


def _judge(seeds: range, every: int = 1) -> Counter[str]:
    """Drive all; every accepted one is without fault."""
    outcomes: Counter[str] = Counter()
    for seed in seeds:
        driven = drive(seed)
        outcomes[driven.refused or "driven"] += 1
        if not driven.refused:
            assert faults_of(driven, every) == [], f"request {seed}"
            outcomes["stopped"] += driven.rest_predicted_rad is not None
            outcomes["slowed near the head"] += bool(driven.plan and driven.plan.speed_steps)
    return outcomes


@pytest.mark.hazard(21)
@pytest.mark.hazard(24)
@pytest.mark.timeout(180)
@pytest.mark.parametrize("batch", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 10))])
def test_random_requests_break_no_limit_do_not_jump_and_stop_as_predicted(batch: int) -> None:
    outcomes = _judge(range(batch * BATCH, (batch + 1) * BATCH), every=8)
    # The requests are worth something only when all of this happens.
    assert outcomes["driven"] > BATCH // 2
    for kind in ("stopped", "slowed near the head", "ARM-007"):
        assert outcomes[kind] >= BATCH // 20, outcomes


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_ten_thousand_random_requests_break_no_limit() -> None:
    _judge(range(10_000))


def test_the_first_set_point_is_the_current_position() -> None:
    for seed in range(8):
        driven = drive(seed)
        if driven.plan is not None and not driven.plan.is_standstill:
            motion = PathMotion(driven.plan.path(MODEL), driven.sent[0], driven.plan.limits, CYCLE_S)
            first = motion.prepare().go_rad
            assert max(abs(x - y) for x, y in zip(first, driven.sent[0], strict=True)) < 1e-4


@pytest.mark.hazard(21)
def test_the_monitor_catches_a_generator_that_ignores_the_zone() -> None:
    for driven in map(drive, PAST_THE_HEAD):
        assert _much_slower(driven)
        assert "speed near the head" in _without_steps(driven)


def _much_slower(driven: Driven) -> bool:
    plan = driven.plan
    return plan is not None and any(step.velocity < 0.5 * plan.limits.velocity for step in plan.speed_steps)


def _without_steps(driven: Driven) -> str:
    plan, limits, surroundings = driven.plan, driven.limits, driven.surroundings
    assert plan is not None
    assert limits is not None
    assert surroundings is not None
    start = plan.start_rad
    monitor = Monitor(monitor_limits(MODEL, limits, CYCLE_S, start), start)
    monitor.watch(LiveWatch(Bodies(MODEL, surroundings), CYCLE_S, start))
    motion = PathMotion(plan.path(MODEL), start, plan.limits, CYCLE_S)
    while not motion.is_finished:
        point = motion.prepare().go_rad
        violation = monitor.check(point)
        if violation is not None:
            return str(violation)
        motion.take_go()
        monitor.sent(point)
    return ""
