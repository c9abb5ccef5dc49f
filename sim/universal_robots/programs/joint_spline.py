"""Splines of External Control: cubic and quintic paths of the joints, and the motion along one.

The last spline of a trajectory may end with a speed. The arm then keeps to the path, ever slower, and comes
to rest at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from sim.universal_robots.robot import Robot

BRAKING_RAD_S2: Final = 15.0  # with which its script lets a trajectory end
LEAST_LEFT_S: Final = 1e-5  # of a path that is slowed down, and then ends

Coefficients = tuple[float, ...]  # lowest first


def cubic(start: tuple[float, float], end: tuple[float, float], time_s: float) -> Coefficients:
    """Return the coefficients of the cubic with these angles and speeds at its ends."""
    (a, va), (b, vb) = start, end
    way = (b - a) / time_s
    return a, va, (3.0 * way - 2.0 * va - vb) / time_s, (va + vb - 2.0 * way) / time_s**2


def quintic(
    start: tuple[float, float, float], end: tuple[float, float, float], time_s: float
) -> Coefficients:
    """Return the coefficients of the quintic with these angles, speeds, accelerations at its ends."""
    (a, va, aa), (b, vb, ab) = start, end
    # What remains at the end of the parabola that the start gives.
    angle = (b - a - va * time_s - aa * time_s**2 / 2.0) / time_s**3
    speed = (vb - va - aa * time_s) / time_s**2
    acceleration = (ab - aa) / time_s
    return (
        a,
        va,
        aa / 2.0,
        10.0 * angle - 4.0 * speed + acceleration / 2.0,
        (-15.0 * angle + 7.0 * speed - acceleration) / time_s,
        (6.0 * angle - 3.0 * speed + acceleration / 2.0) / time_s**2,
    )


def follow_spline(
    robot: Robot,
    joints: Sequence[Coefficients],
    time_s: float,
    *,
    is_last: bool,
    report: Callable[[float], None],
) -> Iterator[None]:
    """Move along a spline, and report its time in each cycle; the speed slider slows it."""
    passed_s = slowing_s = 0.0
    while passed_s < time_s:
        left_s = time_s - passed_s
        if (
            is_last
            and not slowing_s
            and _is_too_fast(joints, passed_s + robot.cycle_s, left_s - robot.cycle_s)
        ):
            slowing_s = left_s + robot.cycle_s
        pace = left_s / slowing_s if slowing_s else 1.0
        passed_s += robot.cycle_s * robot.speed_fraction * pace
        if time_s - passed_s < LEAST_LEFT_S:
            passed_s = time_s
        robot.drives.place([_evaluate(one, passed_s) for one in joints])
        report(passed_s)
        yield


def _is_too_fast(joints: Sequence[Coefficients], time_s: float, left_s: float) -> bool:
    """Return whether a joint could not come to rest in the time left."""
    most = BRAKING_RAD_S2 * max(0.0, left_s)
    return any(abs(_evaluate(_derivative(one), time_s)) > most for one in joints)


def _derivative(coefficients: Coefficients) -> Coefficients:
    return tuple(power * value for power, value in enumerate(coefficients))[1:]


def _evaluate(coefficients: Coefficients, time_s: float) -> float:
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * time_s + coefficient
    return value
