"""What the drives accept: no step, speed or angle that a real arm could not follow. Never a teleport."""

from __future__ import annotations

from sim.kuka.description import Description
from sim.kuka.messages import Message, end_switch, step_too_large, too_fast
from sim.kuka.parameters import ControllerParameters

ROUNDING_DEG = 1e-6  # six decimals travel on the wire


class Supervision:
    """Judges every new command against the one before; one object per run."""

    def __init__(self, arm: Description, cycle_s: float, parameters: ControllerParameters) -> None:
        self._arm = arm
        self._cycle_s = cycle_s
        self._parameters = parameters
        self._full_step_deg = [joint.full_speed_deg_s * cycle_s for joint in arm.joints]
        self._step_deg = [step * parameters.step_share + ROUNDING_DEG for step in self._full_step_deg]
        self._lower_deg = [joint.lower_deg - ROUNDING_DEG for joint in arm.joints]
        self._upper_deg = [joint.upper_deg + ROUNDING_DEG for joint in arm.joints]
        self._fast_cycles = 0

    def judge(self, command_deg: list[float], before_deg: list[float]) -> Message | None:
        """None when the arm can follow, else why it stops."""
        if command_deg is before_deg:
            self._fast_cycles = 0
            return None
        fast_axis = -1
        for axis, (new, old, largest, lower, upper, full) in enumerate(
            zip(
                command_deg,
                before_deg,
                self._step_deg,
                self._lower_deg,
                self._upper_deg,
                self._full_step_deg,
                strict=True,
            )
        ):
            step = new - old
            if step > largest or step < -largest:
                return step_too_large(self._arm.joints[axis].name, step, largest)
            if step > full or step < -full:
                fast_axis = axis
            if new < lower or new > upper:
                return end_switch(self._parameters.end_switch_message, self._arm.joints[axis].name, new)
        self._fast_cycles = self._fast_cycles + 1 if fast_axis >= 0 else 0
        if self._fast_cycles >= self._parameters.overspeed_cycles:
            joint = self._arm.joints[fast_axis]
            speed = (command_deg[fast_axis] - before_deg[fast_axis]) / self._cycle_s
            return too_fast(joint.name, speed, joint.full_speed_deg_s)
        return None
