"""The monitor trips on everything it watches, and on nothing that a good motion does."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ronna_hw.arm.clearance.live_watch import Violation
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.monitor import FOLLOWING_RAD, RANGE_ROUNDING_RAD, Monitor, MonitorLimits, monitor_limits
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.pose import radians6
from ronna_hw.vectors import JointVector

MODEL = kr6_r900(SIXX)
CYCLE_S = 0.004
START = radians6(0, -90, 90, 0, 60, 0)
LIMITS: MonitorLimits = monitor_limits(MODEL, working_limits(MODEL), CYCLE_S, START)


def _with(axis: int, angle_rad: float, base: JointVector = START) -> JointVector:
    joints = list(base)
    joints[axis - 1] = angle_rad
    return (joints[0], joints[1], joints[2], joints[3], joints[4], joints[5])


def _monitor(history: JointVector = START) -> Monitor:
    monitor = Monitor(LIMITS, START)
    for _ in range(3):
        monitor.sent(history)
    return monitor


def _kind(violation: Violation | None) -> tuple[str, int] | None:
    return (violation.kind, violation.axis) if violation else None


def test_standing_still_is_no_violation() -> None:
    assert _monitor().check(START) is None
    assert _monitor().check_measured(START) is None


def test_an_arm_that_leaves_its_place_trips_after_a_long_rest_too() -> None:
    monitor = _monitor()
    for _ in range(3 * LIMITS.following_cycles):
        monitor.sent(START)
        assert monitor.check_measured(START) is None
    away = _with(2, START[1] + 2.0 * FOLLOWING_RAD)
    assert _kind(monitor.check_measured(away)) == ("following error", 2)
    assert monitor.check_measured(START) is None
    for _ in range(LIMITS.following_cycles):
        monitor.sent(away)
    assert _kind(monitor.check_measured(START)) == ("following error", 2)


def test_a_point_within_the_margin_of_a_range_end_trips() -> None:
    margin = LIMITS.limits.range_margin_rad
    edge = _with(1, MODEL.upper_rad[0] - margin)
    assert _monitor(edge).check(edge) is None
    assert _kind(_monitor(edge).check(_with(1, MODEL.upper_rad[0] - margin + 1e-4))) == ("range", 1)
    low = _with(2, MODEL.lower_rad[1] + margin)
    assert _kind(_monitor(low).check(_with(2, MODEL.lower_rad[1] + margin - 1e-4))) == ("range", 2)


def test_an_arm_that_starts_within_the_margin_may_stay_and_move_away() -> None:
    at_end = _with(1, MODEL.upper_rad[0])
    monitor = Monitor(monitor_limits(MODEL, working_limits(MODEL), CYCLE_S, at_end), at_end)
    assert monitor.check(at_end) is None
    assert monitor.check(_with(1, MODEL.upper_rad[0] - 1e-6)) is None
    assert _kind(monitor.check(_with(1, MODEL.upper_rad[0] + 1e-5))) == ("range", 1)


@pytest.mark.hazard(51)
def test_at_reduced_speed_a_tenth_of_full_speed_is_the_limit_of_an_axis() -> None:
    limits = working_limits(MODEL).with_reduced_speed(MODEL)
    monitor = Monitor(monitor_limits(MODEL, limits, CYCLE_S, START), START)
    between = 1.1 * 0.1 * MODEL.full_speed_rad_s[3] * CYCLE_S
    violation = monitor.check(_with(4, START[3] + between))
    assert _kind(violation) == ("speed", 4)
    assert violation is not None
    assert violation.limit == pytest.approx(0.1 * MODEL.full_speed_rad_s[3])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_point_that_is_not_a_number_trips(value: float) -> None:
    assert _kind(_monitor().check(_with(4, value))) == ("range", 4)


@pytest.mark.hazard(18)
@pytest.mark.hazard(22)
@pytest.mark.parametrize(
    ("axis", "shift_rad", "beyond_rad", "kind"),
    [
        (6, 1.01 * LIMITS.step_rad[5], LIMITS.step_rad[5], "speed"),
        (2, 0.5 * LIMITS.step_rad[1], LIMITS.second_difference_rad[1], "acceleration"),
        (1, 0.9 * LIMITS.second_difference_rad[0], LIMITS.third_difference_rad[0], "jerk"),
    ],
    ids=["jump", "kick within the step", "shake within the acceleration"],
)
def test_a_sudden_motion_trips_the_lowest_difference_that_it_exceeds(
    axis: int, shift_rad: float, beyond_rad: float, kind: str
) -> None:
    assert shift_rad > beyond_rad
    assert _kind(_monitor().check(_with(axis, START[axis - 1] + shift_rad))) == (kind, axis)


@pytest.mark.hazard(19)
def test_the_total_correction_is_bounded_by_the_end_switches_minus_the_start_pose() -> None:
    narrow = MonitorLimits(**{**vars(LIMITS), "correction_upper_rad": (0.001,) * 6})
    monitor = Monitor(narrow, START)
    for _ in range(3):
        monitor.sent(_with(1, 0.001))
    assert _kind(monitor.check(_with(1, 0.00101))) == ("total correction", 1)


@pytest.mark.hazard(38)
@pytest.mark.parametrize("sign", [1, -1])
def test_an_arm_at_rest_must_be_where_it_was_sent(sign: int) -> None:
    monitor = _monitor()
    inside = _with(3, START[2] + sign * 0.9 * FOLLOWING_RAD)
    outside = _with(3, START[2] + sign * 1.1 * FOLLOWING_RAD)
    assert monitor.check_measured(inside) is None
    assert _kind(monitor.check_measured(outside)) == ("following error", 3)
    assert _kind(monitor.check_measured(_with(3, math.nan))) == ("following error", 3)


@pytest.mark.hazard(38)
@pytest.mark.parametrize("speed_share", [1.0, 0.1, 0.01])
def test_an_axis_may_lag_by_the_following_time_at_any_speed(speed_share: float) -> None:
    monitor = _monitor()
    step = speed_share * LIMITS.step_rad[2]
    for cycle in range(1, 3 * LIMITS.following_cycles):
        monitor.sent(_with(3, START[2] + cycle * step))
        late = max(0, cycle - LIMITS.following_cycles + 1)
        assert monitor.check_measured(_with(3, START[2] + late * step)) is None
    behind = _with(3, START[2] + late * step - FOLLOWING_RAD - step)
    assert _kind(monitor.check_measured(behind)) == ("following error", 3)
    ahead = _with(3, START[2] + cycle * step + FOLLOWING_RAD + step)
    assert _kind(monitor.check_measured(ahead)) == ("following error", 3)


@pytest.mark.hazard(38)
def test_an_axis_that_reverses_may_still_be_on_its_way_out() -> None:
    monitor = _monitor()
    far = START[2] + 5 * FOLLOWING_RAD
    for angle in (far, START[2]):
        monitor.sent(_with(3, angle))
    assert monitor.check_measured(_with(3, far)) is None
    for _ in range(LIMITS.following_cycles):
        monitor.sent(START)
    assert _kind(monitor.check_measured(_with(3, far))) == ("following error", 3)


@pytest.mark.hazard(38)
def test_an_arm_holding_a_point_because_the_next_was_not_taken_has_no_following_error() -> None:
    monitor = _monitor()
    monitor.sent(_with(3, START[2] + 5 * FOLLOWING_RAD))
    monitor.mark_not_accepted()
    for _ in range(2 * LIMITS.following_cycles):
        monitor.mark_at_rest()
    assert monitor.check_measured(START) is None


@pytest.mark.hazard(18)
def test_a_point_that_was_not_taken_is_judged_again_from_the_held_point() -> None:
    monitor = _monitor()
    near, far = (_with(6, START[5] + share * LIMITS.step_rad[5]) for share in (0.9, 1.1))
    monitor.sent(near)
    assert monitor.held_rad == near
    assert monitor.mark_not_accepted() is None
    assert monitor.held_rad == START
    monitor.mark_sent_again()
    assert monitor.held_rad == near
    assert monitor.history_rad == (near, START, START, START)
    monitor = _monitor()
    monitor.sent(far)
    assert _kind(monitor.mark_not_accepted()) == ("speed", 6)


def test_a_resting_arm_is_judged_from_rest_at_the_held_point() -> None:
    monitor = _monitor()
    step = _with(6, START[5] + 0.5 * LIMITS.step_rad[5])
    monitor.sent(step)
    monitor.mark_not_accepted()
    monitor.mark_at_rest()
    assert monitor.history_rad == (START, START, START, START)
    assert _kind(monitor.check(step)) == ("acceleration", 6) or _kind(monitor.check(step)) == ("jerk", 6)


def test_checking_a_point_does_not_store_it() -> None:
    monitor = _monitor()
    monitor.check(_with(1, 0.5))
    assert monitor.last_rad == START


def test_a_violation_states_axis_value_and_limit() -> None:
    assert str(_monitor().check(_with(6, START[5] + 1.0))).startswith(
        "speed of axis 6: 14323.9 deg/s, limit 73.8 deg/s"
    )


@pytest.mark.hazard(18)
@settings(max_examples=100)
@given(data=st.data())
def test_next_to_every_limit_the_check_of_all_axes_says_what_the_rules_one_by_one_say(
    data: st.DataObject,
) -> None:
    axis = data.draw(st.integers(1, 6))
    i, draw = axis - 1, lambda *values: data.draw(st.sampled_from(values))
    low, high = LIMITS.lower_rad[i], LIMITS.upper_rad[i]
    speed, bend, twist = (
        limits[i] for limits in (LIMITS.step_rad, LIMITS.second_difference_rad, LIMITS.third_difference_rad)
    )
    start = _with(axis, draw(START[i], 0.0, low, high))
    # The total correction ends before the range does, at its end, or behind it.
    limits = replace(
        LIMITS,
        correction_lower_rad=tuple(low - begun - draw(-1e-5, 0.0, 1e-5) for begun in start),
        correction_upper_rad=tuple(high - begun + draw(-1e-5, 0.0, 1e-5) for begun in start),
    )
    monitor = Monitor(limits, start)
    step, change = draw(0.0, speed, -speed, bend), draw(0.0, bend, -bend, twist)
    for behind in (3.0 * step - 3.0 * change, 2.0 * step - change, step, 0.0):
        monitor.sent(_with(axis, start[i] - behind, start))
    latest, previous, earlier, _ = (sent[i] for sent in monitor.history_rad)
    ends = [
        *(end + by * RANGE_ROUNDING_RAD for end in (low, high) for by in (-1.0, -0.5, 0.0, 0.5, 1.0)),
        *(
            start[i] + end + by * RANGE_ROUNDING_RAD
            for end in (limits.correction_lower_rad[i], limits.correction_upper_rad[i])
            for by in (-1.0, -0.5, 0.0, 0.5, 1.0)
        ),
    ]
    for sign in (-1.0, 1.0):
        ends.append(latest + sign * speed)
        ends.append(2.0 * latest - previous + sign * bend)
        ends.append(3.0 * latest - 3.0 * previous + earlier + sign * twist)
    for end in ends:
        near = (end, math.nextafter(end, -math.inf), math.nextafter(end, math.inf))
        for angle in (*near, latest, -0.0, math.nan, math.inf, -math.inf):
            joints = _with(axis, angle, start)
            assert repr(monitor.check(joints)) == repr(monitor._find_axis_violation(joints))
