"""Cyclic set-points. Each cycle prepares the next point and the first point of a stop.

The caller sends one of the two and reports which: `take_go` or `take_stop`. So nothing is left to compute at
the moment of sending, and a stop is never a jump.

A stop without a path continues along the course of the last set-points. Joints that brake independently turn
the tool off its course and can even speed it up. So they brake together: the arm continues along the parabola
through its last set-points while its speed decreases. It leaves a path within the joint limits only in third
order of the stopping distance. With the direction u, the speed v and the acceleration split into a tangential
part a and a normal one, the parabola is q(l) = q0 + u l + k l^2 / 2 with k = normal / v^2, and

    q'' = u l'' + k (l'^2 + l l''),    q''' = u l''' + k (3 l' l'' + l l''').
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import Path
from ronna_hw.arm.motion.progress import (
    AxisState,
    Bounds,
    MotionProfile,
    MotionProfiler,
    PathLimits,
    PathProgress,
    SpeedStep,
)
from ronna_hw.vectors import JointVector, joint_vector

RESTING_RAD_S = 1e-9  # anything slower has no direction
SHARE = 0.99  # of acceleration and jerk, above what plans use: a state estimated from set-points is not exact
SPEED_MARGIN = 1.05  # over the limits, for rounding of a state derived from set-points
BRAKING_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2, 0.1)  # of the largest deceleration: a larger one leaves less jerk
LONGER_TOGETHER = 2.0  # a stop that stays on course may take this many times as long; planned ones need 1.2


class Prepared(NamedTuple):
    """Candidate set-points for the next reply: one to continue, one to stop."""

    go_rad: JointVector
    stop_rad: JointVector


class PathMotion:
    """Rest-to-rest motion along a path, including stops and speed changes."""

    def __init__(
        self,
        path: Path,
        start_rad: JointVector,
        limits: PathLimits,
        cycle_s: float,
        steps: tuple[SpeedStep, ...] = (),
    ) -> None:
        """Start at rest; `steps` are the sections with reduced speed. Raises ARM-006 if no profile exists."""
        self._path = path
        self._along = PathProgress(limits, steps, cycle_s)
        self._joints = start_rad
        self._next: Prepared | None = None

    @property
    def is_finished(self) -> bool:
        return self._along.is_finished

    @property
    def progress(self) -> float:
        """Share of the path up to the point sent last."""
        return self._along.state.position[0]

    @property
    def was_stopped_early(self) -> bool:
        """Whether the motion was stopped before the end of its path."""
        return self._along.is_stopping

    def prepare(self) -> Prepared:
        """Compute the next set-points; raises an error from `arm.errors` where the path has no solution."""
        go, stop = self._along.prepare()
        go_rad = self._joints_at(go, self._joints)
        self._next = Prepared(go_rad, go_rad if stop is go else self._joints_at(stop, go_rad))
        return self._next

    def take_go(self) -> None:
        """Record that the go point was sent."""
        if self._next is not None:
            self._along.take_go()
            self._joints = self._next.go_rad
            self._next = None

    def take_stop(self) -> None:
        """Record that the stop point was sent; from then on, both points belong to the stop."""
        if self._next is not None:
            self._along.take_stop()
            self._joints = self._next.stop_rad
            self._next = None

    def predict_stop(self) -> tuple[float, JointVector]:
        """Return the duration in s and the final joints of a stop starting at the next point."""
        duration_s, parameter = self._along.predict_stop()
        return duration_s, self._path.joints(min(max(parameter, 0.0), 1.0), self._joints)

    def limit_speed(self, fraction: float) -> None:
        """Continue at `fraction` of the planned speed, braking smoothly. No effect during a stop."""
        self._next = None
        self._along.limit_speed(fraction)

    def restart_from_rest(self, *, one_back: bool = False) -> None:
        """Continue from rest at the last point, after a stop outside this motion.

        With `one_back` it is at rest at the point before the last one.
        """
        self._next = None
        self._along.restart_from_rest(one_back=one_back)

    def _joints_at(self, state: AxisState, near: JointVector) -> JointVector:
        return self._path.joints(min(max(state.position[0], 0.0), 1.0), near)


class StopMotion:
    """Stop from any state of motion along the current course, independent of any path.

    If the joints cannot brake together in reasonable time, which never follows from a planned motion, each
    brakes independently.
    """

    def __init__(self, start: AxisState, limits: MotionLimits, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._profile = MotionProfiler(len(start.position)).stop(start, joint_bounds(limits))
        self._halt = plan_halt(start, limits)
        if self._halt is not None:
            if self._halt.profile.duration_s <= LONGER_TOGETHER * self._profile.duration_s:
                self._profile = self._halt.profile
            else:
                self._halt = None
        self._time_s = 0.0

    @property
    def is_finished(self) -> bool:
        return self._time_s >= self._profile.duration_s

    def predict_stop(self) -> tuple[float, JointVector]:
        """Return the remaining duration in s and the final joints."""
        duration_s = self._profile.duration_s
        return max(duration_s - self._time_s, 0.0), self._joints_at(duration_s)

    def prepare(self) -> Prepared:
        joints = self._joints_at(self._time_s + self._cycle_s)
        return Prepared(joints, joints)

    def take_go(self) -> None:
        self._time_s += self._cycle_s

    take_stop = take_go

    def _joints_at(self, time_s: float) -> JointVector:
        if self._halt is not None:
            return self._halt.sample(time_s)
        return joint_vector(self._profile.sample(time_s).position)


def state_from_history(history_rad: Sequence[JointVector], cycle_s: float) -> AxisState:
    """Estimate the motion state at the newest of four set-points from the cubic through them.

    The third difference matters: without it the acceleration is one cycle old, and a stop gains too much
    speed.
    """
    velocity, acceleration = [], []
    for latest, previous, earlier, earliest in zip(*history_rad, strict=True):
        step = latest - previous
        bend = step - (previous - earlier)
        twist = bend - (previous - 2.0 * earlier + earliest)
        velocity.append((step + bend / 2.0 + twist / 3.0) / cycle_s)
        acceleration.append((bend + twist) / cycle_s**2)
    return AxisState(list(history_rad[0]), velocity, acceleration)


def joint_bounds(limits: MotionLimits) -> Bounds:
    """Convert joint limits to profile bounds for all axes."""
    return Bounds(list(limits.speed_rad_s), list(limits.acceleration_rad_s2), list(limits.jerk_rad_s3))


class Parabola(NamedTuple):
    """Joint-space path parameterised by its length in rad, starting at the arm's position."""

    origin_rad: Sequence[float]
    direction: Sequence[float]
    bend_per_rad: Sequence[float]

    def sample(self, length_rad: float) -> JointVector:
        """Return the joints at a given length along the path."""
        half = 0.5 * length_rad * length_rad
        return joint_vector(
            q + u * length_rad + k * half
            for q, u, k in zip(self.origin_rad, self.direction, self.bend_per_rad, strict=True)
        )


class StopProfile(NamedTuple):
    """Stop along a path: the path, and a one-axis profile from the current speed to rest."""

    curve: Parabola
    profile: MotionProfile

    def sample(self, time_s: float) -> JointVector:
        """Return the joints at a given time after the start of the stop."""
        return self.curve.sample(self.profile.sample(time_s).position[0])


def plan_halt(start: AxisState, limits: MotionLimits) -> StopProfile | None:
    """Plan the shortest stop along the current course that the joint limits allow.

    None if the arm has no direction, its curvature alone uses up the limits, or a joint would first become
    too fast. Motions within the limits never cause this.
    """
    if not (speed := hypot(*start.velocity)) > RESTING_RAD_S:
        return None
    direction = [v / speed for v in start.velocity]
    tangential = sum(a * u for a, u in zip(start.acceleration, direction, strict=True))
    bend = [
        (a - tangential * u) / (speed * speed) for a, u in zip(start.acceleration, direction, strict=True)
    ]
    if (bounds := _braking_bounds(direction, bend, speed, limits)) is None:
        return None
    peak = speed + max(tangential, 0.0) ** 2 / (2.0 * bounds.jerk[0])
    fastest = max(abs(u) * peak / most for u, most in zip(direction, limits.speed_rad_s, strict=True))
    if fastest > SPEED_MARGIN:
        return None
    curve = Parabola(start.position, direction, bend)
    return StopProfile(curve, MotionProfiler(1).stop(AxisState([0.0], [speed], [tangential]), bounds))


def _braking_bounds(
    direction: Sequence[float], bend: Sequence[float], speed: float, limits: MotionLimits
) -> Bounds | None:
    """Return the deceleration and jerk of the shortest stop along a path within all joint limits."""
    most = min(
        (SHARE * limits.acceleration_rad_s2[i] - abs(bend[i]) * speed * speed) / abs(direction[i])
        for i in range(len(direction))
        if direction[i]
    )
    found: tuple[float, float, float] | None = None
    for share in BRAKING_SHARES:
        if (deceleration := share * most) <= 0.0:
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
