"""Drive supervision: rejects any step, speed, acceleration or angle that a real arm could not follow.

The arm never teleports. Steps are judged from cycle to cycle, speed and acceleration only if they persist, so
that one value held over a lost reply, and the longer step after it, pass at the speeds of a careful client.
"""

from __future__ import annotations

from collections import deque

from sim.kuka.controller.messages import (
    Message,
    end_switch,
    near_singularity,
    step_too_large,
    too_fast,
    too_much_acceleration,
)
from sim.kuka.controller_parameters import ControllerParameters
from sim.world.nominal_arm import RobotDescription

ROUNDING_DEG = 1e-6  # six decimals on the wire
SHORTEST_WINDOW_CYCLES = 3
TURNING_AXES = (3, 5)  # A4 and A6 turn fast when the wrist is nearly straight


class Supervision:
    """Checks every new command against the previous ones; one object per run."""

    def __init__(
        self,
        arm: RobotDescription,
        cycle_s: float,
        parameters: ControllerParameters,
        *,
        cartesian: bool = False,
    ) -> None:
        """`cartesian`: a pose is corrected, so a wrist axis that cannot follow indicates a singularity."""
        self._arm = arm
        self._turning_axes = TURNING_AXES if cartesian else ()
        self._cycle_s = cycle_s
        self._parameters = parameters
        self._full_step_deg = [joint.full_speed_deg_s * cycle_s for joint in arm.joints]
        self._step_deg = [step * parameters.step_share + ROUNDING_DEG for step in self._full_step_deg]
        self._lower_deg = [joint.lower_deg - ROUNDING_DEG for joint in arm.joints]
        self._upper_deg = [joint.upper_deg + ROUNDING_DEG for joint in arm.joints]
        self._fast_cycles = 0
        self._hard_cycles = 0
        self._still_cycles = self._held_cycles = 0
        window = max(SHORTEST_WINDOW_CYCLES, round(parameters.acceleration_window_s / cycle_s))
        self._window_s = window * cycle_s
        # from the second difference of three commands one window apart
        self._bend_deg = [
            joint.acceleration_deg_s2 * parameters.acceleration_share * self._window_s**2
            for joint in arm.joints
        ]
        self._window = window
        self._past: deque[list[float]] = deque(maxlen=2 * window)  # commands, oldest first

    def within_range(self, command_deg: list[float]) -> list[float]:
        """The command clipped at the software end switches; the same object if nothing is beyond them."""
        cut = [
            min(max(angle, joint.lower_deg), joint.upper_deg)
            for angle, joint in zip(command_deg, self._arm.joints, strict=True)
        ]
        return command_deg if cut == command_deg else cut

    def judge(self, command_deg: list[float], before_deg: list[float], *, heard: bool) -> Message | None:
        """None when the arm can follow, otherwise the message of the stop.

        Acceleration is judged from replies: values held for missing replies (`heard` is false) are not, and
        after a few of them the next command starts from rest.
        """
        past, window = self._past, self._window
        if command_deg is before_deg:
            self._fast_cycles = 0
            if not heard:
                self._held_cycles += 1
                if self._held_cycles > self._parameters.held_cycles:
                    past.clear()
                return None
            self._held_cycles = 0
            self._still_cycles += 1
            if self._still_cycles > window:
                past.clear()  # a window at rest: earlier commands no longer count
                return None
        else:
            self._still_cycles = self._held_cycles = 0
        while len(past) < 2 * window:
            past.append(before_deg)
        oldest, middle = past[0], past[window]
        past.append(command_deg)
        fast_axis = hard_axis = -1
        hardest_deg = 0.0
        for axis, (new, old, largest, full, lower, upper, mid, far, bend) in enumerate(
            zip(
                command_deg,
                before_deg,
                self._step_deg,
                self._full_step_deg,
                self._lower_deg,
                self._upper_deg,
                middle,
                oldest,
                self._bend_deg,
                strict=True,
            )
        ):
            step = new - old
            if step > largest or step < -largest:
                if axis in self._turning_axes:
                    return near_singularity()
                return step_too_large(self._arm.joints[axis].name, step, largest)
            if step > full or step < -full:
                fast_axis = axis
            if new < lower or new > upper:
                return end_switch(self._parameters.end_switch_message, self._arm.joints[axis].name, new)
            change = new - mid - mid + far
            if change > bend or change < -bend:
                hard_axis, hardest_deg = axis, change
        self._hard_cycles = self._hard_cycles + 1 if hard_axis >= 0 else 0
        if self._hard_cycles >= self._parameters.acceleration_cycles:
            square_s2 = self._window_s**2
            return too_much_acceleration(
                self._arm.joints[hard_axis].name,
                hardest_deg / square_s2,
                self._bend_deg[hard_axis] / square_s2,
            )
        self._fast_cycles = self._fast_cycles + 1 if fast_axis >= 0 else 0
        if self._fast_cycles >= self._parameters.overspeed_cycles:
            joint = self._arm.joints[fast_axis]
            speed = (command_deg[fast_axis] - before_deg[fast_axis]) / self._cycle_s
            return too_fast(joint.name, speed, joint.full_speed_deg_s)
        return None
