"""Jerk-limited time profile of the path parameter from 0 to 1, within the local speed limits.

A path may be slower in places (`SpeedStep`): near the head, or where joints move fast. A lower speed is
reached before its section begins; acceleration to a higher one starts once its section has begun.

Profiles come from ruckig, in a typed wrapper that avoids its traps. Ruckig accepts lists of any length and
fails later, raises its own exceptions, extrapolates before the start, and calls a network service when given
waypoints. Here lengths are fixed, errors are ours, times are clamped and there are no waypoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from ronna_hw.arm.errors import MOTION_INVALID

Values = Sequence[float]


class AxisState(NamedTuple):
    """Position, velocity and acceleration, one value per axis."""

    position: list[float]
    velocity: list[float]
    acceleration: list[float]

    @classmethod
    def resting(cls, position: Values) -> AxisState:
        """Build a state at rest at a position."""
        still = [0.0] * len(position)
        return cls(list(position), still, list(still))


class Bounds(NamedTuple):
    """Maximum speed, acceleration and jerk per axis, all positive."""

    velocity: list[float]
    acceleration: list[float]
    jerk: list[float]


class MotionProfile:
    """Computed motion profile. Sampling takes well below a microsecond."""

    def __init__(self, axes: int) -> None:
        self.raw = Trajectory(axes)
        self.duration_s = 0.0

    def sample(self, time_s: float) -> AxisState:
        """Return the state at a time, clamped to the start and end of the profile."""
        position, velocity, acceleration = self.raw.at_time(min(max(time_s, 0.0), self.duration_s))
        return AxisState(position, velocity, acceleration)


class MotionProfiler:
    """Motion-profile calculator for a fixed number of axes."""

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
        self._braking_input = InputParameter(axes)
        self._braking_input.control_interface = ControlInterface.Velocity
        self._braking_input.synchronization = Synchronization.No
        self._braking_input.target_acceleration = [0.0] * axes
        self._bounds_of: dict[InputParameter, Bounds] = {}  # bounds last given to each request

    def move(self, start: AxisState, target: Values, bounds: Bounds) -> MotionProfile:
        """Move all axes from any state to rest at `target`, arriving simultaneously. Raises ARM-006.

        The profile may overshoot start and target if it starts in motion.
        """
        self._check(target)
        self._move.target_position = list(target)
        return self._calculate(self._move, start, bounds)

    def stop(self, start: AxisState, bounds: Bounds) -> MotionProfile:
        """Bring each axis from any state to rest as fast as its bounds allow. Raises ARM-006."""
        return self._calculate(self._stop, start, bounds)

    def brake(self, start: AxisState, velocity: Values, bounds: Bounds) -> MotionProfile:
        """Slow each axis to a lower speed as fast as its bounds allow. Raises ARM-006."""
        self._check(velocity)
        self._braking_input.target_velocity = list(velocity)
        return self._calculate(self._braking_input, start, bounds)

    def _calculate(self, request: InputParameter, start: AxisState, bounds: Bounds) -> MotionProfile:
        for values in start:
            self._check(values)
        if self._bounds_of.get(request) is not bounds:
            for values in bounds:
                self._check(values)
            request.max_velocity, request.max_acceleration, request.max_jerk = bounds
            self._bounds_of[request] = bounds
        request.current_position, request.current_velocity, request.current_acceleration = start
        profile = MotionProfile(self.axes)
        try:
            self._generator.calculate(request, profile.raw)
        except RuckigError as error:
            raise MOTION_INVALID("this motion has no profile", got=" ".join(str(error).split())) from error
        profile.duration_s = profile.raw.duration
        return profile

    def _check(self, values: Values) -> None:
        if len(values) != self.axes:
            raise MOTION_INVALID(f"a profile of {self.axes} axes got {len(values)} values")


MOST_STEPS = 12  # per path; the block that carries a plan to the real-time process has room for this many
ROUNDING = 1e-9  # relative: a speed reached by braking is exact only to the last digits


class PathLimits(NamedTuple):
    """Maximum first, second and third derivatives of the path parameter, per s, s², s³."""

    velocity: float
    acceleration: float
    jerk: float


class SpeedStep(NamedTuple):
    """Speed limit of the path parameter, `velocity` per s, from `start` (0..1) to the next step."""

    start: float
    velocity: float


class StopPrediction(NamedTuple):
    """Duration and final path parameter of a stop initiated now."""

    duration_s: float
    parameter: float


class _Leg(NamedTuple):
    """Active profile, its speed limit, and whether it leads to the end of the path."""

    profile: MotionProfile
    velocity: float
    leads_to_end: bool

    def sample(self, time_s: float) -> AxisState:
        """Return the state at a time; a braking leg continues at its reduced speed."""
        is_over = time_s >= self.profile.duration_s
        if self.leads_to_end:
            return AxisState.resting([1.0]) if is_over else self.profile.sample(time_s)
        if is_over and not self.velocity:
            return AxisState.resting(self.profile.sample(time_s).position)
        return AxisState(*self.profile.raw.at_time(time_s))


class PathProgress:
    """Path-parameter values for each cycle, each paired with the first value of a stop."""

    def __init__(self, limits: PathLimits, steps: tuple[SpeedStep, ...], cycle_s: float) -> None:
        """Start at rest at 0; `steps` are the sections with reduced speed.

        Raises ARM-006 if the limits permit no profile.
        """
        self._limits = limits
        self._steps = steps or (SpeedStep(0.0, limits.velocity),)
        self._cycle_s = cycle_s
        self._fraction = 1.0
        self._profiler = MotionProfiler(1)
        self._stop_bounds = self._bounds(limits.velocity)
        self.state = self._before = AxisState.resting([0.0])
        self._ceiling: SpeedStep | None = None  # the slower step ahead, while braking for it
        self._leg = self._plan_leg(self._speed_at(0.0))
        self._time_s = 0.0
        self._halt: MotionProfile | None = None  # the stop in progress
        self._next: tuple[AxisState, _Leg, float] | None = None  # go state, its leg, and the time on it
        self._next_halt: tuple[AxisState, MotionProfile] | None = None

    @property
    def is_stopping(self) -> bool:
        """Whether a stop has begun."""
        return self._halt is not None

    @property
    def is_finished(self) -> bool:
        """Whether the end of the path or of a stop has been reached."""
        if self._halt is not None:
            return self._time_s >= self._halt.duration_s
        return self._leg.leads_to_end and self._time_s >= self._leg.profile.duration_s

    def prepare(self) -> tuple[AxisState, AxisState]:
        """Return the next states for continuing and for stopping; during a stop, they are the same object."""
        if self._halt is not None:
            go = self._halt.sample(self._time_s + self._cycle_s)
            self._next = (go, self._leg, self._time_s + self._cycle_s)
            return go, go
        go = self.choose_state()
        profile = self._plan_stop(self.state)
        stop = profile.sample(self._cycle_s)
        self._next_halt = (stop, profile)
        return go, stop

    def take_go(self) -> None:
        """Record that the go state was sent."""
        if self._next is None:
            return
        self._before = self.state
        self.state, self._leg, self._time_s = self._next
        self._next = self._next_halt = None
        if self._ceiling is not None and self.state.position[0] >= self._ceiling.start:
            self._ceiling = None

    def take_stop(self) -> None:
        """Record that the stop state was sent; from then on, only the stop continues."""
        if self._halt is not None:
            self.take_go()
        elif self._next_halt is not None:
            self._before = self.state
            self.state, self._halt = self._next_halt
            self._time_s = self._cycle_s
            self._next = self._next_halt = None

    def predict_stop(self) -> StopPrediction:
        """Predict a stop starting at the next point, or the rest of the current stop."""
        profile, elapsed_s = self._halt, self._time_s
        if profile is None:
            profile, elapsed_s = self._plan_stop(self.state), 0.0
        duration_s = profile.duration_s
        return StopPrediction(max(duration_s - elapsed_s, 0.0), profile.sample(duration_s).position[0])

    def limit_speed(self, fraction: float) -> None:
        """Continue at `fraction` of the planned speed, braking smoothly; at 0, to rest until it rises again.

        No effect during a stop.
        """
        if not self.is_stopping and not self.is_finished:
            self._fraction = fraction
            self._next = self._next_halt = None

    def restart_from_rest(self, *, one_back: bool = False) -> None:
        """Continue from rest at the last or second-to-last state, after a stop outside this profile."""
        sample = self._before if one_back else self.state
        self.state = self._before = AxisState.resting([min(max(sample.position[0], 0.0), 1.0)])
        self._next = self._next_halt = self._ceiling = None
        self._time_s = 0.0
        if self._halt is not None:
            self._halt = self._plan_stop(self.state)
        else:
            velocity = self._speed_at(self.state.position[0])
            self._leg = self._plan_leg(velocity) if velocity else self._braking_leg(velocity)

    def choose_state(self) -> AxisState:
        """Return the fastest next state from which the end and every slower section can still be reached.

        `prepare` adds the state of a stop; without one, only `take_go` may follow.
        """
        velocity = self._speed_at(self.state.position[0])
        if self._ceiling is not None:
            velocity = min(velocity, self._ceiling.velocity * self._fraction)
        while True:
            leg, time_s = self._leg, self._time_s + self._cycle_s
            has_braked = not leg.leads_to_end and self._time_s >= leg.profile.duration_s
            if velocity != leg.velocity or (has_braked and velocity):
                leg, time_s = self._choose_leg(velocity)
            go = leg.sample(time_s)
            if (missed := self._find_missed_step(go, velocity)) is None:
                self._next = (go, leg, time_s)
                return go
            self._ceiling, velocity = missed, missed.velocity * self._fraction

    def _choose_leg(self, velocity: float) -> tuple[_Leg, float]:
        """Choose the leg to the end or the braking leg to a lower speed, and the time of its next point.

        If the end is too close to slow down first, the present leg is kept.
        """
        if velocity and _peak_speed(self.state, self._limits.jerk) <= velocity * (1.0 + ROUNDING):
            return self._plan_leg(velocity), self._cycle_s
        braking = self._braking_leg(velocity)
        slow = braking.sample(braking.profile.duration_s)
        if self._leg.leads_to_end and self._stop_position(slow) + slow.velocity[0] * self._cycle_s > 1.0:
            return self._leg._replace(velocity=velocity), self._time_s + self._cycle_s
        return braking, self._cycle_s

    def _find_missed_step(self, go: AxisState, velocity: float) -> SpeedStep | None:
        """Return the slowest upcoming step that `go` would make impossible to respect, or None."""
        found: SpeedStep | None = None
        here = self.state.position[0]
        for step in self._steps:
            slow = step.velocity * self._fraction
            if step.start <= here or slow >= velocity:
                continue
            is_slowest = found is None or step.velocity < found.velocity
            if is_slowest and not self._can_reach_speed(go, slow, step.start):
                found = step
        return found

    def _can_reach_speed(self, go: AxisState, slow: float, start: float) -> bool:
        if (peak := _peak_speed(go, self._limits.jerk)) <= slow:
            return True
        (s,), (v,), (a,) = go
        ahead = 2.0 * v * self._cycle_s  # the decision is made once per cycle
        if s + ahead >= start:
            return False
        # A cheap bound first: the whole braking from the present peak to rest.
        acceleration, jerk = self._limits.acceleration, self._limits.jerk
        fall_s = max(peak / acceleration + acceleration / jerk, 2.0 * sqrt(peak / jerk)) + max(a, 0.0) / jerk
        if s + peak * fall_s + ahead < start:
            return True
        profile = self._profiler.brake(go, [slow], self._bounds(slow))
        slowed = AxisState(*profile.raw.at_time(profile.duration_s))
        return slowed.position[0] + ahead < start and self._stop_position(slowed) + ahead < 1.0

    def _stop_position(self, state: AxisState) -> float:
        profile = self._plan_stop(state)
        return profile.sample(profile.duration_s).position[0]

    def _plan_stop(self, state: AxisState) -> MotionProfile:
        return self._profiler.stop(state, self._stop_bounds)

    def _speed_at(self, s: float) -> float:
        velocity = self._steps[0].velocity
        for step in self._steps:
            if step.start > s:
                break
            velocity = step.velocity
        return velocity * self._fraction

    def _plan_leg(self, velocity: float) -> _Leg:
        bounds = self._bounds(velocity * (1.0 + ROUNDING))
        return _Leg(self._profiler.move(self.state, [1.0], bounds), velocity, True)

    def _braking_leg(self, velocity: float) -> _Leg:
        bounds = self._bounds(velocity) if velocity else self._stop_bounds
        return _Leg(self._profiler.brake(self.state, [velocity], bounds), velocity, False)

    def _bounds(self, velocity: float) -> Bounds:
        return Bounds([velocity], [self._limits.acceleration], [self._limits.jerk])


def _peak_speed(state: AxisState, jerk: float) -> float:
    """Return the lowest possible peak speed, reached once the acceleration has ramped down to zero."""
    (v,), (a,) = state.velocity, state.acceleration
    return v + a * a / (2.0 * jerk) if a > 0.0 else v


def drive_states(limits: PathLimits, steps: tuple[SpeedStep, ...], cycle_s: float) -> list[AxisState]:
    """Return the states along a path driven from rest to rest, one per cycle."""
    progress = PathProgress(limits, steps, cycle_s)
    states: list[AxisState] = []
    while not progress.is_finished:
        progress.choose_state()
        progress.take_go()
        states.append(progress.state)
    return states
