"""A path that comes too close to anything is refused; the live watch stops what planning missed."""

from __future__ import annotations

import json
import math
import random
from dataclasses import replace
from math import inf

import pytest
from monitored_motion import drive_monitored

from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Corridor, Obstacle, Part, SpeedZone, Surroundings
from ronna_hw.arm.clearance.live_watch import LiveWatch
from ronna_hw.arm.clearance.sweep import sweep, sweep_path
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.monitor import Monitor, monitor_limits
from ronna_hw.arm.motion.limits import REDUCED_SPEED_MM_S, working_limits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.progress import MOST_STEPS
from ronna_hw.arm.motion.set_points import PathMotion
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.preview import preview, with_speed_steps

MODEL = kr6_r900(SIXX)
LIMITS = working_limits(MODEL)
CYCLE_S = 0.004
START = radians6(0, -75, 99, 0, 66, 180)
ASIDE = radians6(50, -75, 99, 0, 66, 180)
TOOL = Pose((0.0, 0.0, 150.0))
NEEDLE = Part("needle", Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 150.0), 3.0), enters_head=True)
ZONE = SpeedZone(20.0, 60.0, 400.0, 1000.0)


def _at(angle_deg: float, below_mm: float = 0.0) -> tuple[float, float, float]:
    """Where the tip is when A1 stands at an angle, and so far below."""
    x, y, z = MODEL.forward(radians6(angle_deg, -75, 99, 0, 66, 180)).apply(TOOL.position_mm)
    return (x, y, z - below_mm)


def _post(angle_deg: float, top_below_tip_mm: float, radius_mm: float = 2.0) -> Obstacle:
    """An upright thin post on the tip's way from START to ASIDE; its top so far under the tip."""
    x, y, z = _at(angle_deg, top_below_tip_mm + radius_mm + 3.0)
    return Obstacle("post", Capsule((x, y, z), (x, y, z - 300.0), radius_mm))


def _around(*obstacles: Obstacle, **more: object) -> Surroundings:
    return Surroundings(tool=(NEEDLE,), obstacles=obstacles, **more)  # type: ignore[arg-type]


def _move() -> MotionPlan:
    return plan_joint_move(MODEL, START, ASIDE, LIMITS)


def _along_the_needle(distance_mm: float) -> MotionPlan:
    tool = MODEL.forward(START).compose(TOOL)
    goal = Pose(tool.apply((0.0, 0.0, distance_mm)), tool.rotation).compose(TOOL.inverse())
    return plan_line(MODEL, START, goal, LIMITS, TOOL.position_mm)


@pytest.mark.hazard(24)
def test_a_thin_post_in_the_way_is_found_between_the_first_samples() -> None:
    path = sweep_path(MODEL, _move(), _around(_post(23.0, 9.0)))
    with pytest.raises(
        NotClear, match=r"needle would come too close to the post, 4\d% of the path"
    ) as caught:
        path.require("the move")
    assert caught.value.code == "ARM-007"
    assert caught.value.limit == "10 mm"
    assert "\n" not in str(caught.value)
    assert path.refused is not None
    assert path.refused.distance_mm == pytest.approx(9.0, abs=0.2)


def test_a_post_beyond_the_margin_is_accepted() -> None:
    path = sweep_path(MODEL, _move(), _around(_post(23.0, 11.0)))
    path.require()
    assert path.closest is not None
    assert path.closest.second == "post"
    assert path.closest.distance_mm == pytest.approx(11.0, abs=1.0)


def test_bodies_at_a_constant_distance_are_reported_closest_at_the_start_of_the_path() -> None:
    path = sweep_path(MODEL, _move(), Surroundings())  # A1 alone turns: what it carries turns together
    gaps_mm = path.swept.gaps_mm.min(axis=1)
    assert gaps_mm.max() - gaps_mm.min() < 1e-9
    assert path.closest is not None
    assert path.closest.fraction == 0.0


def test_the_closest_pair_is_one_that_the_motion_changes() -> None:
    path = sweep_path(MODEL, _move(), _around(_post(23.0, 60.0)))  # farther than what turns together
    constant_mm = sweep_path(MODEL, _move(), _around(_post(2000.0, 60.0))).swept.gaps_mm.min()
    assert path.closest is not None
    assert path.closest.second == "post"
    assert path.closest.distance_mm > constant_mm


def test_a_pair_below_the_planned_clearance_is_told_although_the_motion_leaves_it_as_it_is() -> None:
    around = replace(_around(_post(23.0, 60.0)), margin_mm=200.0)
    constant_mm = sweep_path(MODEL, _move(), replace(around, obstacles=())).swept.gaps_mm.min()
    path = sweep_path(MODEL, _move(), around)
    assert path.closest is not None
    assert path.closest.distance_mm == pytest.approx(constant_mm)


def test_a_body_that_is_too_close_may_move_away_but_not_closer() -> None:
    beside = _around(_post(0.0, 4.0))
    sweep_path(MODEL, _along_the_needle(-40.0), beside).require()
    with pytest.raises(NotClear):
        sweep_path(MODEL, _along_the_needle(3.0), beside).require()


@pytest.mark.hazard(24)
def test_only_the_needle_enters_the_head_and_only_along_its_corridor() -> None:
    x, y, z = _at(0.0)
    head = Obstacle("head", Capsule((x, y, z - 110.0), (x, y, z - 110.0), 80.0), is_head=True)
    into = _along_the_needle(60.0)
    axis_end = MODEL.forward(into.target_rad).apply(TOOL.position_mm)
    corridor = Corridor((x, y, z), axis_end, 2.5)
    around = _around(head)
    with pytest.raises(NotClear, match="needle would come too close to the head"):
        sweep_path(MODEL, into, around).require()
    sweep_path(MODEL, into, replace(around, corridor=corridor)).require()
    beside = corridor._replace(
        entry_mm=(x, y + 6.0, z), target_mm=(axis_end[0], axis_end[1] + 6.0, axis_end[2])
    )
    with pytest.raises(NotClear):
        sweep_path(MODEL, into, replace(around, corridor=beside)).require()
    blunt = Surroundings(tool=(NEEDLE._replace(enters_head=False),), obstacles=(head,), corridor=corridor)
    with pytest.raises(NotClear):
        sweep_path(MODEL, into, blunt).require()


def _drive(plan: MotionPlan, around: Surroundings) -> str:
    """What the monitor says on the way, or nothing."""
    monitor = Monitor(monitor_limits(MODEL, LIMITS, CYCLE_S, START), START)
    monitor.watch(LiveWatch(Bodies(MODEL, around), CYCLE_S, START))
    motion = PathMotion(plan.path(MODEL), START, plan.limits, CYCLE_S, plan.speed_steps)
    outcome = drive_monitored(motion, monitor)
    return "" if isinstance(outcome, int) else str(outcome)


@pytest.mark.hazard(24)
def test_the_live_watch_stops_what_planning_did_not_refuse() -> None:
    around = _around(_post(23.0, 4.0))
    said = _drive(_move(), around)
    assert said.startswith("clearance of pair")
    assert "limit 5.0 mm" in said
    assert _drive(_move(), _around(_post(23.0, 6.0))) == ""


@pytest.mark.hazard(21)
def test_a_path_past_the_head_is_slow_there_and_fast_elsewhere() -> None:
    x, y, z = _at(25.0)
    head = Obstacle("head", Capsule((x, y, z - 120.0), (x, y, z - 120.0), 60.0), is_head=True)
    around = _around(head, zone=ZONE)
    plan = _move()
    slowed = with_speed_steps(plan, sweep_path(MODEL, plan, around), inf)
    speeds = [step.velocity for step in slowed.speed_steps]
    assert 3 <= len(speeds) <= MOST_STEPS
    assert min(speeds) < 0.6 * max(speeds)
    assert _drive(slowed, around) == ""
    assert _drive(plan, around).startswith("speed near the head")


def test_without_a_zone_there_are_no_speed_steps() -> None:
    path = sweep_path(MODEL, _move(), _around(_post(23.0, 30.0)))
    assert with_speed_steps(_move(), path, inf).speed_steps == ()


def test_at_reduced_speed_nothing_moves_faster_than_250_mm_per_second() -> None:
    limits = LIMITS.with_reduced_speed(MODEL)
    for speed, full in zip(limits.speed_rad_s, MODEL.full_speed_rad_s, strict=True):
        assert speed <= 0.1 * full
    plan = plan_joint_move(MODEL, START, ASIDE, limits)
    fast = preview(MODEL, _move(), _around(), LIMITS)
    slow = preview(MODEL, plan, _around(), limits)
    assert fast.largest_speed_mm_s > REDUCED_SPEED_MM_S > slow.largest_speed_mm_s > 0.9 * REDUCED_SPEED_MM_S
    assert slow.duration_s > fast.duration_s


def test_a_speed_cap_is_linear_between_two_distances() -> None:
    assert ZONE.cap_mm_s(0.0) == ZONE.cap_mm_s(20.0) == 60.0
    assert ZONE.cap_mm_s(210.0) == pytest.approx(530.0)
    assert ZONE.cap_mm_s(5000.0) == 1000.0
    assert Surroundings().cap_mm_s(1.0) == math.inf


def test_a_preview_predicts_duration_ranges_singularity_speed_and_clearance() -> None:
    seen = preview(MODEL, _move(), _around(_post(23.0, 11.0)), LIMITS)
    assert seen.clear
    motion = PathMotion(_move().path(MODEL), START, _move().limits, CYCLE_S)
    cycles = 0
    while not motion.is_finished:
        motion.prepare()
        motion.take_go()
        cycles += 1
    assert seen.duration_s == pytest.approx(cycles * CYCLE_S)
    assert seen.joint_ranges_rad[0] == pytest.approx((0.0, math.radians(50)))
    assert seen.singularity.wrist == pytest.approx(math.sin(math.radians(66)))
    assert seen.singularity.least > 0.2
    assert 0.9 < seen.largest_joint_speed_share <= 1.0 + 2e-9  # a profile reaches its limit to 1e-9
    assert seen.nearest_to_head_mm is None
    payload = json.loads(json.dumps(seen.as_payload(), allow_nan=False))
    assert payload["closest"]["second"] == "post"
    assert payload["clear"] is True


@pytest.mark.hazard(5)
def test_after_a_stop_anywhere_the_remaining_path_is_checked_again_and_refused_if_not_clear() -> None:
    """The detour over a high post; from wherever it was stopped, straight on to the goal."""
    around = _around(_post(23.0, -60.0))
    high_start, high_end = radians6(0, -95, 99, 0, 66, 180), radians6(50, -95, 99, 0, 66, 180)
    rng = random.Random(6)
    outcomes = {True: 0, False: 0}
    for _ in range(24):
        leg = rng.choice(((START, high_start), (high_start, high_end), (high_end, ASIDE)))
        plan = plan_joint_move(MODEL, *leg, LIMITS)
        sweep_path(MODEL, plan, around).require()
        stopped_at = plan.path(MODEL).joints(rng.random(), START)
        onwards = plan_joint_move(MODEL, stopped_at, ASIDE, LIMITS)
        clear = sweep_path(MODEL, onwards, around).refused is None
        densely = [onwards.path(MODEL).joints(k / 150, stopped_at) for k in range(151)]
        gaps = sweep(Bodies(MODEL, around), densely).gaps_mm
        assert clear == bool((gaps.min(axis=0) >= around.margin_mm - 0.3).all())
        outcomes[clear] += 1
    assert outcomes[True] >= 3
    assert outcomes[False] >= 3


def test_a_path_with_nothing_around_is_not_refused() -> None:
    nothing = Surroundings(radii=Surroundings().radii._replace(column_mm=0.001))
    assert sweep_path(MODEL, _move(), nothing).refused is None
