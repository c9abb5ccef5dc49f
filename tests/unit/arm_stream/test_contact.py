"""Motions in contact: a force limit, a hand that the arm follows, and what prevents both."""

from __future__ import annotations

from math import dist, nan, radians

import pytest
from coded_errors import raises
from rtde_stand import CYCLE_S, FAR, LIMITS, MODEL, START, RtdeStand, streaming

from ronna_hw.arm.errors import INSERTION_INVALID
from ronna_hw.arm_stream.drill_feed import DrillWatch
from ronna_hw.arm_stream.guided import GuideLimits
from ronna_hw.arm_stream.hand_guided import guide_limits
from ronna_hw.arm_stream.insertion import has_begun, plan_insertion
from ronna_hw.arm_stream.records import ForceLimit, GuideByHand, MotionResult, StopOrder
from ronna_hw.devices.contact import HandGuidance, Insertion
from ronna_hw.frames import Frame, Transform

SENSES = {"force_filter_s": 0.02, "force_at_rest_N": 15.0}
REST_CYCLES = 300
GUIDE = GuideLimits(50.0, 60.0, 8.0, 0.6, 2500)
LIMIT_N = 60.0
TOOL = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(0.0, 0.0, 120.0))


def resting(force_N: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> RtdeStand:
    stand = RtdeStand(**SENSES).begin()
    stand.force_N = force_N
    stand.cycles(REST_CYCLES)
    return stand


def move(stand: RtdeStand, limit_N: float) -> None:
    stand.move(force=ForceLimit(limit_N))


def guide(stand: RtdeStand, limits: GuideLimits = GUIDE) -> None:
    stand.give(GuideByHand(limits, LIMIT_N))
    stand.cycle()


def flange_mm(stand: RtdeStand) -> tuple[float, float, float]:
    return MODEL.forward(stand.goal).position_mm


@pytest.mark.parametrize("force_N", [(0.0, 31.0, 0.0), (0.0, 0.0, -40.0), (nan, 0.0, 0.0)])
def test_a_motion_stops_when_its_force_limit_is_exceeded(force_N: tuple[float, float, float]) -> None:
    stand = resting()
    move(stand, 30.0)
    stand.cycles(200)
    assert stand.session.moving
    stand.force_N = force_N
    stand.run()
    assert stand.session.result is MotionResult.FORCE
    assert stand.goal != pytest.approx(FAR, abs=0.01)
    assert not stand.session.fault


def test_a_force_below_the_limit_or_a_bias_does_not_stop_a_motion() -> None:
    stand = resting((6.0, -6.0, 6.0))
    move(stand, 30.0)
    stand.cycles(200)
    stand.force_N = (6.0, -6.0, 34.0)
    stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.session.state(real_time=False, locked=False).peak_force_N == pytest.approx(28.0, abs=0.1)


DRILL = DrillWatch(
    slow_N=18.0,
    hold_N=27.6,
    touch_N=4.0,
    free_N=1.0,
    fall_share=0.4,
    earliest=1.0,
    free=0.9,
    bone_from=1.0,
    bone_by=0.5,
    side_N=8.0,
    friction=0.0,
    axis=(0.0, 0.6, -0.8),
)


@pytest.mark.hazard(66)
@pytest.mark.parametrize(
    ("force_N", "end"),
    [
        ((0.0, -6.0, 8.0), MotionResult.DONE),  # against the feed: bone
        ((0.0, 6.0, -8.0), MotionResult.BONELESS),  # a pull
        ((7.0, 0.0, 0.0), MotionResult.BONELESS),  # across it
        ((0.0, 8.0, 6.0), MotionResult.ASIDE),
    ],
)
def test_a_drill_is_judged_by_the_force_along_its_axis(
    force_N: tuple[float, float, float], end: MotionResult
) -> None:
    stand = resting()
    stand.move(force=ForceLimit(30.0, drill=DRILL))
    stand.cycles(50)
    stand.force_N = force_N
    stand.run()
    assert stand.session.result is end


@pytest.mark.hazard(65)
def test_a_force_across_that_hides_whether_bone_resists_ends_the_feed_which_tells_where_bone_did() -> None:
    stand = resting()
    stand.move(force=ForceLimit(30.0, drill=DRILL._replace(friction=0.35, free=0.2)))
    stand.cycles(50)
    stand.force_N = (0.0, -6.0, 8.0)  # bone
    stand.cycles(20)
    stand.force_N = (7.0, -1.2, 1.6)  # 2 N along, 7 N across
    stand.run()
    state = stand.session.state(real_time=False, locked=False)
    assert stand.session.result is MotionResult.HIDDEN
    assert state.is_in_bone
    assert not state.is_through
    assert state.free_share >= 1.0


@pytest.mark.hazard(56)
@pytest.mark.parametrize(("goes_on", "end"), [(True, MotionResult.FORCE), (False, MotionResult.DONE)])
def test_what_presses_while_a_motion_is_held_counts_once_it_goes_on(goes_on: bool, end: MotionResult) -> None:
    stand = resting()
    move(stand, 30.0)
    stand.cycles(200)
    stand.stop(StopOrder.HOLD)
    stand.force_N = (0.0, 0.0, 14.0)
    stand.cycles(2 * REST_CYCLES)
    stand.move(force=ForceLimit(30.0, goes_on))
    stand.force_N = (0.0, 0.0, 31.0)
    stand.run()
    assert stand.session.result is end


@pytest.mark.parametrize(("goes_on", "peak_N"), [(True, 12.0), (False, 0.0)])
def test_the_largest_force_counts_from_the_tare_also_over_a_stop(goes_on: bool, peak_N: float) -> None:
    stand = resting()
    move(stand, 30.0)
    stand.cycles(200)
    stand.force_N = (0.0, 12.0, 0.0)
    stand.cycles(100)
    stand.stop(StopOrder.HOLD)
    stand.force_N = (0.0, 0.0, 0.0)
    stand.cycles(2 * REST_CYCLES)
    stand.move(force=ForceLimit(30.0, goes_on))
    stand.run()
    assert stand.session.result is MotionResult.DONE
    assert stand.session.state(real_time=False, locked=False).peak_force_N == pytest.approx(peak_N, abs=0.1)


def test_a_force_at_the_start_cannot_be_tared_away() -> None:
    stand = resting((0.0, 16.0, 0.0))
    move(stand, 30.0)
    stand.cycles(3)
    assert stand.session.result is MotionResult.REFUSED_LOADED
    assert not stand.session.moving


def test_an_arm_without_an_estimate_starts_no_motion_with_a_force_limit() -> None:
    stand = streaming()
    stand.cycles(REST_CYCLES)
    move(stand, 30.0)
    stand.cycles(3)
    assert stand.session.result is MotionResult.REFUSED_LOADED


def test_a_guided_arm_goes_with_the_hand_no_faster_than_its_limit() -> None:
    stand = resting()
    guide(stand)
    begin = flange_mm(stand)
    stand.force_N = (0.0, 20.0, 0.0)
    stand.cycles(500)
    x, y, z = flange_mm(stand)
    assert y - begin[1] == pytest.approx(20.0, abs=4.0)  # (20 - 8) N / 0.6 N s/mm for nearly a second
    assert (x, z) == pytest.approx((begin[0], begin[2]), abs=0.01)
    stand.force_N = (0.0, 55.0, 0.0)
    before = flange_mm(stand)
    fastest = 0.0
    for _ in range(300):
        stand.cycle()
        fastest, before = max(fastest, dist(flange_mm(stand), before) / CYCLE_S), flange_mm(stand)
    assert fastest < 1.01 * GUIDE.speed_mm_s
    assert MODEL.forward(stand.goal).angle_rad(MODEL.forward(START)) < radians(0.01)


@pytest.mark.hazard(57)
def test_a_guided_arm_comes_to_rest_at_the_end_of_its_reach_however_hard_the_hand_pushes() -> None:
    stand = resting()
    guide(stand)
    begin = flange_mm(stand)
    stand.force_N = (0.0, 55.0, 0.0)
    farthest = 0.0
    for _ in range(2000):
        stand.cycle()
        farthest = max(farthest, dist(flange_mm(stand), begin))
    assert GUIDE.reach_mm - 2.0 < farthest <= GUIDE.reach_mm
    assert not stand.session.fault


def test_a_guided_arm_stands_still_without_a_hand_and_ends_by_its_time() -> None:
    stand = resting()
    guide(stand)
    stand.force_N = (5.0, -5.0, 0.0)
    stand.run()
    assert stand.session.result is MotionResult.STOPPED
    assert len(set(stand.goals[-2000:])) == 1


def test_a_hand_that_pushes_too_hard_stops_the_guided_arm() -> None:
    stand = resting()
    guide(stand)
    stand.force_N = (0.0, 80.0, 0.0)
    count = stand.run()
    assert stand.session.result is MotionResult.FORCE
    assert count < 300


def test_a_guided_arm_stops_before_the_end_of_a_joint_range_without_a_fault() -> None:
    stand = resting()
    guide(stand, GUIDE._replace(reach_mm=300.0, cycles=20_000))
    stand.force_N = (0.0, 0.0, 55.0)  # up, until the elbow is stretched or a joint would be too fast
    for _ in range(8000):
        stand.cycle()
        if stand.session.result is not MotionResult.RUNNING:
            break
    assert not stand.session.fault


@pytest.mark.parametrize(
    "changes", [{"speed_mm_s": 51.0}, {"reach_mm": 400.0}, {"force_limit_N": 5.0}, {"timeout_s": nan}]
)
def test_a_guidance_that_no_person_may_be_exposed_to_is_refused(changes: dict[str, float]) -> None:
    with raises(INSERTION_INVALID):
        guide_limits(HandGuidance(**changes), CYCLE_S)


def target(along_mm: float, aside_mm: float = 0.0) -> Transform:
    way = Transform.of(Frame.TOOL, Frame.TOOL, translation_mm=(aside_mm, 0.0, along_mm))
    return MODEL.flange_pose(START) @ TOOL @ way


def test_an_insertion_is_a_line_at_its_speed() -> None:
    line = plan_insertion(MODEL, START, Insertion(target(20.0), TOOL, 2.0), LIMITS)
    assert line.speed_fraction * LIMITS.line_speed_mm_s == pytest.approx(2.0)


@pytest.mark.parametrize(
    "insertion",
    [
        Insertion(target(20.0, aside_mm=0.25), TOOL),
        Insertion(target(20.0), TOOL, 5.1),
        Insertion(target(20.0), TOOL, nan),
        Insertion(target(20.0), TOOL, force_limit_N=0.0),
        Insertion(target(20.0, aside_mm=2.6), TOOL, start=target(0.0)),
        Insertion(target(20.0), TOOL, 15.1, in_bore=True),
        Insertion(target(20.0, aside_mm=0.25), TOOL, start=target(0.0, aside_mm=0.25)),
    ],
)
def test_an_insertion_off_its_axis_or_beyond_its_limits_is_refused(insertion: Insertion) -> None:
    with raises(INSERTION_INVALID):
        plan_insertion(MODEL, START, insertion, LIMITS)


def test_a_calibrated_arm_is_led_along_the_line_that_its_errors_bend() -> None:
    """From any place on it, as after a stop."""
    end, start = target(120.0, aside_mm=0.4), target(-40.0, aside_mm=-0.4 / 3.0)
    assert plan_insertion(MODEL, START, Insertion(end, TOOL, start=start), LIMITS).target is end


@pytest.mark.parametrize(("start", "begun"), [(None, False), (target(-0.5), False), (target(-40.0), True)])
def test_an_insertion_goes_on_once_it_is_past_its_start(start: Transform | None, begun: bool) -> None:
    assert has_begun(MODEL, START, Insertion(target(20.0), TOOL, start=start)) is begun
