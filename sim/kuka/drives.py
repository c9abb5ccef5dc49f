"""Simulated drives: response of six axes to commands, and the supervision that trips them.

Angles are encoder degrees. A list of angles is never modified in place, so an unchanged command is the same
object, and an arm at rest costs nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import exp

from sim.kuka.controller_parameters import IPO_FAST_S, ControllerParameters
from sim.kuka.pendant import COMMAND_ACCELERATION, PendantMessage, end_switch, near_singularity, too_fast
from sim.world.gears import Gears
from sim.world.nominal_arm import AXES, RobotDescription
from sim.world.world import ArmState

STICKS_AGAIN_SHARE = 0.5  # share of the breakaway below which a lagging axis sticks again; a fast one slides

ROUNDING_DEG = 1e-6  # six decimals on the wire
SHORTEST_WINDOW_CYCLES = 3
TURNING_AXES = (3, 5)  # A4 and A6 turn fast when the wrist is nearly straight


class Drives(Gears):
    """Six axes with dead time, lag, exact settling and braking."""

    def __init__(
        self,
        arm: RobotDescription,
        start_deg: Sequence[float],
        parameters: ControllerParameters,
        last: ArmState | None = None,
    ) -> None:
        super().__init__(start_deg, parameters.reversal_deg, last)
        self._parameters = parameters
        self._acceleration_deg_s2 = [joint.acceleration_deg_s2 for joint in arm.joints]
        self.axes_deg: list[float] = list(start_deg)
        self.command_deg: list[float] = self.axes_deg
        self.at_rest = True
        self._speed_deg_s: list[float] = [0.0] * AXES
        self._braking = False
        self._braking_share = parameters.path_stop_share
        self._slipping: dict[int, bool] = {}  # axes that stick, and whether they are slipping
        self._cycle_s = 0.0
        self._pending: deque[list[float]] = deque()
        self.start_cycles(IPO_FAST_S)

    def start_cycles(self, cycle_s: float, filter_s: float = 0.0) -> None:
        """Prepare for a command every `cycle_s`, starting at rest, optionally behind a controller filter."""
        self._cycle_s = cycle_s
        self._share = 1.0 - exp(-cycle_s / self._parameters.lag_s)
        self._filter_share = 1.0 - exp(-cycle_s / filter_s) if filter_s else 1.0
        self._filtered_deg = self.command_deg
        self._pending = deque([self.command_deg] * self._parameters.dead_time_cycles)

    def step(self, command_deg: list[float], *, has_reply: bool = True) -> None:
        """Advance one cycle; `has_reply` is False if the command is merely held for lack of a reply."""
        if command_deg is self.command_deg:
            if self.at_rest:
                return
            if has_reply:
                self._in_motion = False
        else:
            step_deg = self._parameters.motion_speed_deg_s * self._cycle_s
            self._turn(command_deg, self.command_deg, step_deg)
        self._pending.append(command_deg)
        follow_deg = self._pending.popleft()
        wanted_deg = follow_deg if self._filter_share == 1.0 else self._filter(follow_deg)
        share, before = self._share, self.axes_deg
        axes = [y + share * (u - y) for u, y in zip(wanted_deg, before, strict=True)]
        if self._slipping:
            self._hold_sticking(axes, before, wanted_deg)
        self._approach_flanks(share)
        self.command_deg = command_deg
        if follow_deg is command_deg and self._has_arrived(axes, command_deg):
            # The pose at rest is exact: it depends on the command and the flanks, not on the time taken.
            self.axes_deg = self._rest_position(axes, command_deg)
            self.flanks = list(self._directions)
            self._speed_deg_s = [0.0] * AXES
            self._pending = deque([command_deg] * self._parameters.dead_time_cycles)
            self._filtered_deg = command_deg
            self.at_rest = True
            return
        self.at_rest = False
        self.moved_s += self._cycle_s
        self.axes_deg = axes
        self._speed_deg_s = [(y - old) / self._cycle_s for y, old in zip(axes, before, strict=True)]

    def brake(self, *, fast: bool = False) -> None:
        """Stop on the axes' braking ramps, ignoring commands."""
        self._braking = not self.at_rest
        parameters = self._parameters
        self._braking_share = parameters.fast_stop_share if fast else parameters.path_stop_share

    def stick(self, axes: frozenset[int]) -> None:
        """Set the axes (0 to 5) affected by stick-slip."""
        if axes != self._slipping.keys():
            self._slipping = {axis: self._slipping.get(axis, False) for axis in axes}
            self.at_rest = self.at_rest and self.axes_deg == self.command_deg

    def settle(self) -> None:
        """Advance one cycle without a program: finish braking, or approach the last command."""
        if not self._braking:
            self.step(self.command_deg)
            return
        speeds, axes = [], []
        for angle, speed, limit in zip(
            self.axes_deg, self._speed_deg_s, self._acceleration_deg_s2, strict=True
        ):
            change = limit * self._braking_share * self._cycle_s
            slower = max(0.0, abs(speed) - change) * (1.0 if speed > 0 else -1.0)
            speeds.append(slower)
            axes.append(angle + slower * self._cycle_s)
        self.axes_deg, self._speed_deg_s = axes, speeds
        self.moved_s += self._cycle_s
        if not any(speeds):
            self._braking = self._in_motion = False
            self.command_deg = self._filtered_deg = self.axes_deg
            self.flanks = list(self._directions)
            self._extremes = list(axes)
            self._pending = deque([axes] * self._parameters.dead_time_cycles)
            self.at_rest = True

    def _filter(self, follow_deg: list[float]) -> list[float]:
        share = self._filter_share
        self._filtered_deg = [
            y + share * (u - y) for u, y in zip(follow_deg, self._filtered_deg, strict=True)
        ]
        return self._filtered_deg

    def _has_arrived(self, axes_deg: list[float], command_deg: list[float]) -> bool:
        limit = self._parameters.rest_error_deg
        if self._slipping:
            return all(
                -limit < u - y < limit or self._slipping.get(axis) is False
                for axis, (u, y) in enumerate(zip(command_deg, axes_deg, strict=True))
            )
        return all(-limit < u - y < limit for u, y in zip(command_deg, axes_deg, strict=True))

    def _hold_sticking(self, axes_deg: list[float], before_deg: list[float], follow_deg: list[float]) -> None:
        """Hold each sticking axis until the command is far enough ahead, then release it."""
        for axis in self._slipping:
            ahead = abs(follow_deg[axis] - before_deg[axis])
            if ahead > self._parameters.stick_breakaway_deg:
                self._slipping[axis] = True
            elif ahead < self._parameters.stick_breakaway_deg * STICKS_AGAIN_SHARE:
                self._slipping[axis] = False
            if not self._slipping[axis]:
                axes_deg[axis] = before_deg[axis]

    def _rest_position(self, axes_deg: list[float], command_deg: list[float]) -> list[float]:
        """Return the rest position, which is the command except for sticking axes."""
        held = [axis for axis, slips in self._slipping.items() if not slips]
        if not held:
            return command_deg
        return [axes_deg[axis] if axis in held else angle for axis, angle in enumerate(command_deg)]


class Supervision:
    """Drive supervision of one run: rejects steps, speeds, accelerations and angles that no arm can follow.

    Steps are judged from cycle to cycle, speed and acceleration only if they persist. One value held over a
    lost reply, and the longer step after it, therefore pass at the speeds of a careful client.
    """

    def __init__(
        self,
        arm: RobotDescription,
        cycle_s: float,
        parameters: ControllerParameters,
        *,
        cartesian: bool = False,
    ) -> None:
        """Attribute excessive wrist steps to a singularity if poses are corrected (`cartesian`)."""
        self._arm = arm
        self._turning_axes = TURNING_AXES if cartesian else ()
        self._cycle_s = cycle_s
        self._parameters = parameters
        self._full_step_deg = [joint.full_speed_deg_s * cycle_s for joint in arm.joints]
        self._step_deg = [step * parameters.step_share + ROUNDING_DEG for step in self._full_step_deg]
        self._usual_step_deg = [
            min(step, full) for step, full in zip(self._step_deg, self._full_step_deg, strict=True)
        ]
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

    def clip_to_range(self, command_deg: list[float]) -> list[float]:
        """Clip the command to the software end switches, returning the same object if it is within range."""
        cut = [
            min(max(angle, joint.lower_deg), joint.upper_deg)
            for angle, joint in zip(command_deg, self._arm.joints, strict=True)
        ]
        return command_deg if cut == command_deg else cut

    def judge(
        self, command_deg: list[float], before_deg: list[float], *, has_reply: bool
    ) -> PendantMessage | None:
        """Return the message for a stop, or None if the arm can follow.

        Values held for missing replies (`has_reply` is false) do not count as acceleration; after a few of
        them the next command starts from rest.
        """
        past, window = self._past, self._window
        if command_deg is before_deg:
            self._fast_cycles = 0
            if not has_reply:
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
        for new, old, step, lower, upper, mid, far, bend in zip(
            command_deg,
            before_deg,
            self._usual_step_deg,
            self._lower_deg,
            self._upper_deg,
            middle,
            oldest,
            self._bend_deg,
            strict=True,
        ):
            if not (
                -step <= new - old <= step
                and lower <= new <= upper
                and -bend <= new - mid - mid + far <= bend
            ):
                break
        else:
            self._hard_cycles = self._fast_cycles = 0
            return None
        return self._judge_axes(command_deg, before_deg, middle, oldest)

    def _judge_axes(
        self, command_deg: list[float], before_deg: list[float], middle: list[float], oldest: list[float]
    ) -> PendantMessage | None:
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
                text = f"{self._arm.joints[axis].name}: step {step:.4f} deg, at most {largest:.4f}"
                return PendantMessage(COMMAND_ACCELERATION, f"command acceleration {text}", drives_off=True)
            if step > full or step < -full:
                fast_axis = axis
            if new < lower or new > upper:
                return end_switch(self._parameters.end_switch_message, self._arm.joints[axis].name, new)
            change = new - mid - mid + far
            if change > bend or change < -bend:
                hard_axis, hardest_deg = axis, change
        self._hard_cycles = self._hard_cycles + 1 if hard_axis >= 0 else 0
        if self._hard_cycles >= self._parameters.acceleration_cycles:
            found, limit = (bend / self._window_s**2 for bend in (hardest_deg, self._bend_deg[hard_axis]))
            text = f"{self._arm.joints[hard_axis].name}: {found:.0f} deg/s2, at most {limit:.0f}"
            return PendantMessage(COMMAND_ACCELERATION, f"command acceleration {text}", drives_off=True)
        self._fast_cycles = self._fast_cycles + 1 if fast_axis >= 0 else 0
        if self._fast_cycles >= self._parameters.overspeed_cycles:
            joint = self._arm.joints[fast_axis]
            speed = (command_deg[fast_axis] - before_deg[fast_axis]) / self._cycle_s
            return too_fast(joint.name, speed, joint.full_speed_deg_s)
        return None
