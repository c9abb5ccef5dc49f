"""Jerk-limited motion profiles over time: a typed wrapper of ruckig that avoids its traps.

Ruckig accepts lists of any length and fails later, raises its own exceptions, extrapolates before the start,
and calls a network service when given waypoints. Here lengths are fixed, errors are ours, times are clamped
and there are no waypoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from ronna_hw.arm.errors import MotionInvalid

Values = Sequence[float]


class State(NamedTuple):
    """Position, velocity and acceleration: one value per axis each."""

    position: list[float]
    velocity: list[float]
    acceleration: list[float]

    @classmethod
    def resting(cls, position: Values) -> State:
        """At rest at a position."""
        still = [0.0] * len(position)
        return cls(list(position), still, list(still))


class Bounds(NamedTuple):
    """Largest speed, acceleration and jerk per axis; all above zero."""

    velocity: list[float]
    acceleration: list[float]
    jerk: list[float]


class MotionProfile:
    """One computed profile. Sampling costs well below a microsecond."""

    def __init__(self, axes: int) -> None:
        self.raw = Trajectory(axes)
        self.duration_s = 0.0

    def at(self, time_s: float) -> State:
        """State at a time; before the start it is the start's, after the end the end's."""
        position, velocity, acceleration = self.raw.at_time(min(max(time_s, 0.0), self.duration_s))
        return State(position, velocity, acceleration)


class MotionProfiler:
    """Computes profiles for a fixed number of axes."""

    def __init__(self, axes: int) -> None:
        self.axes = axes
        self._generator = Ruckig(axes)
        self._move = InputParameter(axes)
        self._move.synchronization = Synchronization.Time
        self._move.target_velocity = [0.0] * axes
        self._move.target_acceleration = [0.0] * axes
        self._stop = InputParameter(axes)
        self._stop.control_interface = ControlInterface.Velocity
        self._stop.synchronization = Synchronization.No
        self._stop.target_velocity = [0.0] * axes
        self._stop.target_acceleration = [0.0] * axes
        self._slower = InputParameter(axes)
        self._slower.control_interface = ControlInterface.Velocity
        self._slower.synchronization = Synchronization.No
        self._slower.target_acceleration = [0.0] * axes

    def move(self, start: State, target: Values, bounds: Bounds) -> MotionProfile:
        """All axes to rest at `target` simultaneously, from any state. Raises ARM-006.

        The profile may overshoot start and target if it starts in motion.
        """
        self._check(target)
        self._move.target_position = list(target)
        return self._calculate(self._move, start, bounds)

    def stop(self, start: State, bounds: Bounds) -> MotionProfile:
        """Each axis to rest as fast as its bounds allow, from any state. Raises ARM-006."""
        return self._calculate(self._stop, start, bounds)

    def brake(self, start: State, velocity: Values, bounds: Bounds) -> MotionProfile:
        """Each axis to a lower speed as fast as its bounds allow. Raises ARM-006."""
        self._check(velocity)
        self._slower.target_velocity = list(velocity)
        return self._calculate(self._slower, start, bounds)

    def _calculate(self, request: InputParameter, start: State, bounds: Bounds) -> MotionProfile:
        for values in (*start, *bounds):
            self._check(values)
        request.current_position, request.current_velocity, request.current_acceleration = start
        request.max_velocity, request.max_acceleration, request.max_jerk = bounds
        profile = MotionProfile(self.axes)
        try:
            self._generator.calculate(request, profile.raw)
        except RuckigError as error:
            raise MotionInvalid("this motion has no profile", got=" ".join(str(error).split())) from error
        profile.duration_s = profile.raw.duration
        return profile

    def _check(self, values: Values) -> None:
        if len(values) != self.axes:
            raise MotionInvalid(f"a profile of {self.axes} axes got {len(values)} values")
