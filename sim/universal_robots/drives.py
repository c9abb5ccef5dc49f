"""Six joints that follow their target: servo, interpolated set-points, speeds, braking.

Exactly one of `servo`, `place`, `speed` and `brake` acts in a cycle. A list of angles is never modified in
place, so an unchanged target is the same object, and an arm at rest costs nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import copysign, exp, isfinite, sqrt

from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.model import FULL_SPEED_RAD_S, JOINT_RANGE_RAD, JOINTS, LARGEST_ACCELERATION_RAD_S2

IMPOSSIBLE_RAD_S = 100.0  # sum over the joints beyond which a set-point is not followed at all
ARRIVED_RAD = 1e-7  # from where the servo goes to its goal exactly
STILL: list[float] = [0.0] * JOINTS
USUAL_SPEED_RAD_S = (FULL_SPEED_RAD_S,) * JOINTS  # of a UR5 and a UR5e


class Drives:
    """Target and measured joint angles, in rad."""

    def __init__(
        self,
        start_rad: Sequence[float],
        cycle_s: float,
        parameters: ControllerParameters,
        full_speed_rad_s: Sequence[float] = USUAL_SPEED_RAD_S,
    ) -> None:
        self._cycle_s = cycle_s
        self._largest_change = LARGEST_ACCELERATION_RAD_S2 * cycle_s
        self._full_speed = full_speed_rad_s
        # The parameter is that of a joint with the usual speed; a faster one trips in proportion (U).
        self._largest_speed = parameters.largest_speed_rad_s * (max(full_speed_rad_s) / FULL_SPEED_RAD_S)
        self.target: list[float] = list(start_rad)
        self.target_speed: list[float] = STILL
        self.target_acceleration: list[float] = STILL
        self._behind = deque([(self.target, STILL)] * parameters.drive_delay_cycles)
        self.actual: list[float] = self.target
        self.actual_speed: list[float] = STILL
        self._servo_lag_s = 0.0
        self._servo_rate = 0.0
        self.served = 0  # cycles in which the drives were told what to do
        self.trip = ""  # why the arm must stop: the first limit that was reached

    @property
    def moving(self) -> bool:
        """Whether the target is moving."""
        return self.target_speed is not STILL

    @property
    def at_rest(self) -> bool:
        """Whether target and arm stand still."""
        return self.actual_speed is STILL and self.target_speed is STILL and self.actual is self.target

    def servo(self, goal: list[float], lag_s: float) -> None:
        """Move towards a goal with a lag, within the accelerations of the drives."""
        if goal == self.target and self.target_speed is STILL:
            self._finish(self.target, STILL)
            return
        if not isfinite(sum(goal)):
            self.trip = "a target that is not finite"
            self.coast()
            return
        if lag_s != self._servo_lag_s:
            self._servo_lag_s = lag_s
            self._servo_rate = (1.0 - exp(-self._cycle_s / lag_s)) / self._cycle_s
        rate, most, cycle_s = self._servo_rate, self._largest_change, self._cycle_s
        joints, speeds, arrived = [], [], True
        joint_states = zip(goal, self.target, self.target_speed, self._full_speed, strict=True)
        for wanted, angle, speed, full_speed in joint_states:
            error = wanted - angle
            following = error * rate
            if not (-most <= following - speed <= most and abs(following) <= full_speed):
                # As fast as it can still brake in time.
                fastest = min(full_speed, sqrt(2.0 * LARGEST_ACCELERATION_RAD_S2 * abs(error)))
                following = max(-fastest, min(fastest, following))
                following = max(speed - most, min(speed + most, following))
            if -ARRIVED_RAD < error < ARRIVED_RAD and -most < following < most:
                joints.append(wanted)
                speeds.append(0.0)
            else:
                arrived = False
                joints.append(angle + following * cycle_s)
                speeds.append(following)
        self._finish(joints, STILL if arrived else speeds)

    def place(self, joints_rad: list[float]) -> None:
        """Take a set-point of an interpolator."""
        if joints_rad == self.target:
            self._finish(self.target, STILL)
            return
        cycle_s = self._cycle_s
        speeds = [(new - old) / cycle_s for new, old in zip(joints_rad, self.target, strict=True)]
        self._finish(joints_rad, speeds)

    def speed(self, speeds_rad_s: Sequence[float], acceleration_rad_s2: float) -> None:
        """Change towards speeds, all joints in proportion, the leading one with that acceleration."""
        changes = [wanted - speed for wanted, speed in zip(speeds_rad_s, self.target_speed, strict=True)]
        largest = max(map(abs, changes))
        most = acceleration_rad_s2 * self._cycle_s
        share = 1.0 if largest <= most else most / largest
        speeds = [speed + share * change for speed, change in zip(self.target_speed, changes, strict=True)]
        if not any(speeds):
            self._finish(self.target, STILL)
            return
        self._finish(
            [angle + speed * self._cycle_s for angle, speed in zip(self.target, speeds, strict=True)], speeds
        )

    def brake(self, deceleration_rad_s2: float) -> None:
        """Slow down, all joints in proportion."""
        if self.target_speed is STILL:
            self._finish(self.target, STILL)
        else:
            self.speed(STILL, deceleration_rad_s2)

    def coast(self) -> None:
        """Keep the speed for a cycle."""
        cycle_s = self._cycle_s
        self._finish(
            [angle + speed * cycle_s for angle, speed in zip(self.target, self.target_speed, strict=True)],
            self.target_speed,
        )

    def _finish(self, joints: list[float], speeds: list[float]) -> None:
        self.served += 1
        if speeds is not STILL:
            cycle_s = self._cycle_s
            if not sum(map(abs, speeds)) <= IMPOSSIBLE_RAD_S:  # nor if one is no number
                self.trip = "a set-point that no joint can follow"
                speeds = self.target_speed
                joints = [angle + speed * cycle_s for angle, speed in zip(self.target, speeds, strict=True)]
            self.target_acceleration = [
                (new - old) / cycle_s for new, old in zip(speeds, self.target_speed, strict=True)
            ]
            highest = max(*speeds, -min(speeds))
            if highest > self._largest_speed:
                self.trip = f"joint speed {highest:.2f} rad/s, at most {self._largest_speed:.2f}"
            farthest = max(*joints, -min(joints))
            if farthest > JOINT_RANGE_RAD:
                joint = next(n for n, angle in enumerate(joints) if abs(angle) > JOINT_RANGE_RAD)
                end = copysign(JOINT_RANGE_RAD, joints[joint])
                self.trip = f"joint {joint} beyond its limit at {end:.2f} rad"
        elif self.target_acceleration is not STILL:
            self.target_acceleration = STILL
        self.target, self.target_speed = joints, speeds
        behind = self._behind
        if not behind:
            self.actual, self.actual_speed = joints, speeds
        elif self.actual is not joints or self.actual_speed is not speeds or behind[-1][0] is not joints:
            behind.append((joints, speeds))
            self.actual, self.actual_speed = behind.popleft()
