"""Set-points cycle by cycle. Each preparation yields the next point and the first point of a stop.

The caller sends one of the two and reports which: `take_go` or `take_stop`. So at the moment of sending there
is nothing left to compute, and a stop is never a jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.motion_profile import Bounds, MotionProfiler, State
from ronna_hw.arm.motion.path import Path
from ronna_hw.arm.motion.progress import PathLimits, PathProgress, SpeedStep
from ronna_hw.arm.motion.stopping import halt
from ronna_hw.devices.readings import JointVector

LONGER_TOGETHER = 2.0  # a stop that stays on course may take this many times as long; planned ones need 1.2


class Prepared(NamedTuple):
    """The two set-points that the next reply may carry."""

    go_rad: JointVector
    stop_rad: JointVector


class PathMotion:
    """Follows a path from rest to rest; stops and speed changes stay on the path."""

    def __init__(
        self,
        path: Path,
        start_rad: JointVector,
        limits: PathLimits,
        cycle_s: float,
        steps: tuple[SpeedStep, ...] = (),
    ) -> None:
        """`steps` are the slower sections of the path. Raises ARM-006 when no profile exists."""
        self._path = path
        self._along = PathProgress(limits, steps, cycle_s)
        self._joints = start_rad
        self._next: Prepared | None = None

    @property
    def finished(self) -> bool:
        return self._along.finished

    @property
    def stopped_early(self) -> bool:
        """Whether it was stopped before its end."""
        return self._along.stopping

    def prepare(self) -> Prepared:
        """The next set-points; raises an error of `ronna_hw.arm.errors` when the path has no solution."""
        go, stop = self._along.prepare()
        go_rad = self._at(go)
        self._next = Prepared(go_rad, go_rad if stop is go else self._at(stop))
        return self._next

    def take_go(self) -> None:
        """The go point was sent."""
        if self._next is not None:
            self._along.take_go()
            self._joints = self._next.go_rad
            self._next = None

    def take_stop(self) -> None:
        """The stop point was sent; from now on both points are those of the stop."""
        if self._next is not None:
            self._along.take_stop()
            self._joints = self._next.stop_rad
            self._next = None

    def predicted_stop(self) -> tuple[float, JointVector]:
        """Duration in s and resting joints of a stop that would begin with the next point."""
        duration_s, parameter = self._along.predicted_stop()
        return duration_s, self._path.joints(min(max(parameter, 0.0), 1.0), self._joints)

    def limit_speed(self, fraction: float) -> None:
        """Continue at `fraction` of the planned speed, braking smoothly; a stop is not affected."""
        self._next = None
        self._along.limit_speed(fraction)

    def restart_from_rest(self, *, one_back: bool = False) -> None:
        """The arm was brought to rest elsewhere, at the last point: continue from there at speed zero.

        With `one_back` it is at rest at the point before the last one.
        """
        self._next = None
        self._along.restart_from_rest(one_back=one_back)

    def _at(self, state: State) -> JointVector:
        return self._path.joints(min(max(state.position[0], 0.0), 1.0), self._joints)


class StopMotion:
    """Comes to rest from any state without relying on a path: onwards along the present course.

    If the joints cannot brake together in reasonable time, which never follows from a planned motion, each
    brakes independently.
    """

    def __init__(self, start: State, limits: MotionLimits, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._profile = MotionProfiler(len(start.position)).stop(start, joint_bounds(limits))
        self._halt = halt(start, limits)
        if self._halt is not None:
            if self._halt.profile.duration_s <= LONGER_TOGETHER * self._profile.duration_s:
                self._profile = self._halt.profile
            else:
                self._halt = None
        self._time_s = 0.0

    @property
    def finished(self) -> bool:
        return self._time_s >= self._profile.duration_s

    def predicted_stop(self) -> tuple[float, JointVector]:
        """Remaining duration in s, and the joints at rest."""
        duration_s = self._profile.duration_s
        return max(duration_s - self._time_s, 0.0), self._at(duration_s)

    def prepare(self) -> Prepared:
        joints = self._at(self._time_s + self._cycle_s)
        return Prepared(joints, joints)

    def take_go(self) -> None:
        self._time_s += self._cycle_s

    take_stop = take_go

    def _at(self, time_s: float) -> JointVector:
        return _vector(self._profile.at(time_s)) if self._halt is None else self._halt.at(time_s)


def state_from_history(history_rad: Sequence[JointVector], cycle_s: float) -> State:
    """State of motion at the last of four set-points, newest first: that of the cubic through them.

    The third difference matters: without it the acceleration is one cycle old, and a stop
    gains too much speed.
    """
    velocity, acceleration = [], []
    for one, two, three, four in zip(*history_rad, strict=True):
        step = one - two
        bend = step - (two - three)
        twist = bend - (two - 2.0 * three + four)
        velocity.append((step + bend / 2.0 + twist / 3.0) / cycle_s)
        acceleration.append((bend + twist) / cycle_s**2)
    return State(list(history_rad[0]), velocity, acceleration)


def joint_bounds(limits: MotionLimits) -> Bounds:
    """Limits of the joints as bounds of a profile for all axes."""
    return Bounds(list(limits.speed_rad_s), list(limits.acceleration_rad_s2), list(limits.jerk_rad_s3))


def _vector(state: State) -> JointVector:
    a, b, c, d, e, f = state.position
    return (a, b, c, d, e, f)
