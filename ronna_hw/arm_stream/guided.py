"""Motion that follows a hand: a velocity in proportion to its force, within speed, reach and joint limits.

The flange is shifted and never turned. Towards the end of its reach the arm slows down, so that it comes to
rest there however hard the hand pushes.
"""

from __future__ import annotations

from math import hypot, radians
from typing import Annotated, NamedTuple

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import ACCELERATION_RAMP_S, MotionLimits
from ronna_hw.arm.motion.progress import AxisState, Bounds, MotionProfiler
from ronna_hw.arm.motion.set_points import Prepared
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import JointVector, Vector3

ACCELERATION_MM_S2 = 200.0  # half of that on lines: a person's hand is on the arm
WALL_TIME_S = 0.3  # the distance to the end of the reach lasts this long at the permitted speed
JOINT_SPEED_SHARE = 0.9  # of the limits; what needs more is too close to a singular posture
RANGE_MARGIN_RAD = radians(2.0)  # from the permitted ranges: a stop begins there
STILL = [0.0, 0.0, 0.0]
STANDSTILL_MM_S, STANDSTILL_MM_S2 = 1e-6, 1e-3


class GuideLimits(NamedTuple):
    """Limits of a guidance by hand."""

    speed_mm_s: float
    reach_mm: float
    dead_band_N: float
    damping_N_s_mm: float
    cycles: Annotated[int, "I"]  # at most

    def velocity(self, force_N: Vector3) -> Vector3:
        """Return the velocity that a force asks for, mm/s."""
        if (size := hypot(*force_N)) <= self.dead_band_N:
            return 0.0, 0.0, 0.0
        speed = min((size - self.dead_band_N) / self.damping_N_s_mm, self.speed_mm_s)
        x, y, z = force_N
        return x * speed / size, y * speed / size, z * speed / size


class GuidedMotion:
    """Set-points of an arm that follows a hand until it is stopped; `push` gives the force of each cycle."""

    def __init__(
        self,
        kinematics: Kinematics,
        start_rad: JointVector,
        guide: GuideLimits,
        limits: MotionLimits,
        cycle_s: float,
    ) -> None:
        begin = kinematics.forward(start_rad)
        self._kinematics = kinematics
        self._branch = kinematics.branch_of(start_rad)
        self._rotation = begin.rotation
        self._origin = begin.position_mm
        self._guide = guide
        self._cycle_s = cycle_s
        self._steps_rad = [JOINT_SPEED_SHARE * speed * cycle_s for speed in limits.speed_rad_s]
        lower, upper = limits.ranges(kinematics, start_rad)
        self._ranges = [
            (min(low + RANGE_MARGIN_RAD, start), max(high - RANGE_MARGIN_RAD, start))
            for low, start, high in zip(lower, start_rad, upper, strict=True)
        ]
        self._profiler = MotionProfiler(3)
        acceleration = [ACCELERATION_MM_S2] * 3
        jerk = [ACCELERATION_MM_S2 / ACCELERATION_RAMP_S] * 3
        self._bounds = Bounds([guide.speed_mm_s] * 3, acceleration, jerk)
        self._state = AxisState.resting(self._origin)
        self._joints = start_rad
        self._next: tuple[AxisState, JointVector, AxisState, JointVector] | None = None
        self._force: Vector3 = (0.0, 0.0, 0.0)
        self._speed = 1.0
        self._cycles = 0
        self._stopping = False
        self.is_at_limit = False  # stopped by a joint's range or speed

    @property
    def is_finished(self) -> bool:
        """Return whether the arm was stopped and is at rest."""
        return self._stopping and self._is_still

    @property
    def is_over(self) -> bool:
        """Return whether the time is over or a joint is at its limit."""
        return self.is_at_limit or self._cycles >= self._guide.cycles

    @property
    def _is_still(self) -> bool:
        state = self._state
        return hypot(*state.velocity) < STANDSTILL_MM_S and hypot(*state.acceleration) < STANDSTILL_MM_S2

    def push(self, force_N: Vector3) -> None:
        """Take the force of the hand."""
        self._force = force_N

    def limit_speed(self, fraction: float) -> None:
        """Follow at `fraction` of the speed."""
        self._speed = fraction

    def prepare(self) -> Prepared:
        """Compute the next set-points; raises an error from `arm.errors` where there are none."""
        wanted = list(STILL) if self._stopping or self.is_over else self._wanted_velocity()
        if self._is_still and not any(wanted):
            rest = AxisState.resting(self._state.position)
            self._next = (rest, self._joints, rest, self._joints)
            return Prepared(self._joints, self._joints)
        stop = self._after_a_cycle(STILL)
        stop_rad = self._joints_at(stop)
        go, go_rad = stop, stop_rad
        if any(wanted):
            go = self._after_a_cycle(wanted)
            go_rad = self._joints_at(go)
            if not self._may_be(go_rad):
                self.is_at_limit = True
                go, go_rad = stop, stop_rad
        self._next = (go, go_rad, stop, stop_rad)
        return Prepared(go_rad, stop_rad)

    def take_go(self) -> None:
        """Record that the go point was sent."""
        if self._next is not None:
            self._state, self._joints, _, _ = self._next
            self._next = None
            self._cycles += 1

    def take_stop(self) -> None:
        """Record that the stop point was sent; from then on, only the stop continues."""
        if self._next is not None:
            _, _, self._state, self._joints = self._next
            self._next = None
            self._stopping = True

    def _wanted_velocity(self) -> list[float]:
        """Return the velocity that hand, speed and reach allow."""
        velocity = [self._speed * value for value in self._guide.velocity(self._force)]
        offset = [here - begin for here, begin in zip(self._state.position, self._origin, strict=True)]
        if (away := hypot(*offset)) > 0.0:
            out = [value / away for value in offset]
            outwards = sum(v * u for v, u in zip(velocity, out, strict=True))
            permitted = max(self._guide.reach_mm - away, 0.0) / WALL_TIME_S
            if outwards > permitted:
                velocity = [v - (outwards - permitted) * u for v, u in zip(velocity, out, strict=True)]
        return velocity

    def _after_a_cycle(self, velocity: list[float]) -> AxisState:
        profile = self._profiler.brake(self._state, velocity, self._bounds)
        return AxisState(*profile.raw.at_time(self._cycle_s))

    def _joints_at(self, state: AxisState) -> JointVector:
        x, y, z = state.position
        return self._kinematics.solve_branch(Pose((x, y, z), self._rotation), self._branch, self._joints)

    def _may_be(self, joints_rad: JointVector) -> bool:
        return all(
            abs(angle - before) <= step and low <= angle <= high
            for angle, before, step, (low, high) in zip(
                joints_rad, self._joints, self._steps_rad, self._ranges, strict=True
            )
        )
