"""Comes to rest without relying on a path: onwards along the course of the last set-points.

Joints that brake independently turn the tool off its course and can even speed it up. So they brake together:
the arm continues along the parabola through its last set-points while its speed decreases. It leaves a path
within the joint limits only in third order of the stopping distance.

With the direction u, the speed v and the acceleration split into a tangential part a and a normal one, the
parabola is q(l) = q0 + u l + k l^2 / 2 with k = normal / v^2, and

    q'' = u l'' + k (l'^2 + l l''),    q''' = u l''' + k (3 l' l'' + l l''').
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.motion_profile import Bounds, MotionProfile, MotionProfiler, State
from ronna_hw.devices.readings import JointVector

RESTING_RAD_S = 1e-9  # anything slower has no direction
SHARE = 0.99  # of acceleration and jerk, above what plans use: a state estimated from set-points is not exact
SPEED_MARGIN = 1.05  # over the limits, for rounding of a state derived from set-points
BRAKING_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2, 0.1)  # of the largest deceleration: a larger one leaves less jerk


class Parabola(NamedTuple):
    """A path through joint space parameterised by its length in rad; at 0 it is the arm's position."""

    origin_rad: Sequence[float]
    direction: Sequence[float]
    bend_per_rad: Sequence[float]

    def at(self, length_rad: float) -> JointVector:
        """The joints at this length along it."""
        half = 0.5 * length_rad * length_rad
        a, b, c, d, e, f = (
            q + u * length_rad + k * half
            for q, u, k in zip(self.origin_rad, self.direction, self.bend_per_rad, strict=True)
        )
        return (a, b, c, d, e, f)


class Halt(NamedTuple):
    """A path, and a one-axis profile along it from the present speed to rest."""

    way: Parabola
    profile: MotionProfile

    def at(self, time_s: float) -> JointVector:
        """The joints after a time."""
        return self.way.at(self.profile.at(time_s).position[0])


def halt(start: State, limits: MotionLimits) -> Halt | None:
    """The stop along the present course, as short as the joint limits allow.

    None if the arm has no direction, if its curvature alone uses up the limits, or if a joint would become
    too fast before the acceleration is reduced. Motions within the limits do none of this.
    """
    speed = hypot(*start.velocity)
    if not speed > RESTING_RAD_S:
        return None
    direction = [v / speed for v in start.velocity]
    tangential = sum(a * u for a, u in zip(start.acceleration, direction, strict=True))
    bend = [
        (a - tangential * u) / (speed * speed) for a, u in zip(start.acceleration, direction, strict=True)
    ]
    bounds = _braking(direction, bend, speed, limits)
    if bounds is None:
        return None
    peak = speed + max(tangential, 0.0) ** 2 / (2.0 * bounds.jerk[0])
    fastest = max(abs(u) * peak / most for u, most in zip(direction, limits.speed_rad_s, strict=True))
    if fastest > SPEED_MARGIN:
        return None
    way = Parabola(start.position, direction, bend)
    return Halt(way, MotionProfiler(1).stop(State([0.0], [speed], [tangential]), bounds))


def _braking(
    direction: Sequence[float], bend: Sequence[float], speed: float, limits: MotionLimits
) -> Bounds | None:
    """Deceleration and jerk along a path that respect every joint's limits, for the shortest stop."""
    most = min(
        (SHARE * limits.acceleration_rad_s2[i] - abs(bend[i]) * speed * speed) / abs(direction[i])
        for i in range(len(direction))
        if direction[i]
    )
    found: tuple[float, float, float] | None = None
    for share in BRAKING_SHARES:
        deceleration = share * most
        if deceleration <= 0.0:
            break
        length = speed * speed / deceleration
        jerk = min(
            (SHARE * limits.jerk_rad_s3[i] - 3.0 * abs(bend[i]) * speed * deceleration)
            / (abs(direction[i]) + abs(bend[i]) * length)
            for i in range(len(direction))
            if direction[i] or bend[i]
        )
        if jerk <= 0.0:
            continue
        # A short stop does not reach full deceleration.
        reached = min(deceleration, (speed * jerk) ** 0.5)
        duration_s = speed / reached + reached / jerk
        if found is None or duration_s < found[0]:
            found = (duration_s, deceleration, jerk)
    if found is None:
        return None
    _, deceleration, jerk = found
    return Bounds([speed], [deceleration], [jerk])
