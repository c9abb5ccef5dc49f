"""Conversion of faults and refusals of a stream to the driver's errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import degrees
from operator import attrgetter
from typing import Any

from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.live_watch import Violation, ViolationKind
from ronna_hw.arm.errors import LOADED_AT_START, ForceLimitExceeded
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm_stream.drill_feed import LONGEST_REST_S
from ronna_hw.arm_stream.errors import StreamErrors
from ronna_hw.arm_stream.losses import DEGRADED_SPEED, UNUSABLE_SHARE, WINDOW_CYCLES
from ronna_hw.arm_stream.options import StreamOptions
from ronna_hw.arm_stream.records import (
    NO_STATE,
    NOTHING_AROUND,
    ForceLimit,
    LinkFault,
    LinkState,
    MotionResult,
)
from ronna_hw.errors import AnyCode, LimitError, LinkTimeout, RefusedError, RonnaError, StateError

_REFUSALS = {
    MotionResult.REFUSED_BUSY: "another motion is running",
    MotionResult.REFUSED_START: "it was planned from a pose other than the last one sent",
    MotionResult.REFUSED_PHASE: "no correction stream is running",
    MotionResult.REFUSED_NUMBERS: "no motion profile exists for its values",
}

SENSOR_SILENT = "its sensor sends nothing, or the same values again and again"
LOOK_AT_SENSOR = "Check the force sensor's cable and supply before any motion with a force limit."


@dataclass(frozen=True)
class StreamFaults:
    """Errors of one arm's stream, in the words and with the limits of its driver."""

    name: str
    arm: Kinematics
    errors: StreamErrors
    options: StreamOptions

    def error(
        self, state: LinkState, mode: str, surroundings: Surroundings = NOTHING_AROUND, reported: Any = None
    ) -> RonnaError | None:
        """Build the error for a latched fault, if any; `reported` is the controller's last state."""
        name, errors = self.name, self.errors
        prefix = f"{name}: after {state.cycles} cycles"
        match state.fault:
            case LinkFault.NONE:
                return None
            case LinkFault.MONITOR:
                return monitor_error(prefix, state, self.arm, surroundings, mode, errors.tripped)
            case LinkFault.SILENCE:
                return self.silence_error(state)
            case LinkFault.HEARTBEAT:
                return errors.heartbeat_late(
                    f"{prefix} this program's heartbeat was late",
                    limit=f"{self.options.heartbeat_limit_s:g} s",
                )
            case LinkFault.PROTECTIVE:
                return errors.protective_stop(f"{name}: a protective stop was requested")
            case LinkFault.LINK_STOP:
                return errors.link_stopped(f"{name}: replies were stopped on request")
            case LinkFault.DRIVES_OFF:
                return errors.drives_off(f"{name}: the drives were switched off on request")
            case LinkFault.PATH:
                return errors.path_failed(f"{prefix} the path had no solution")
            case LinkFault.LOSSES:
                return errors.unusable(
                    f"{prefix} too few replies were accepted{self.losses_text(NO_STATE, state)}",
                    limit=f"{UNUSABLE_SHARE:.0%} of {WINDOW_CYCLES} cycles, in two consecutive windows",
                )
        return errors.unusable(f"{prefix} the stream ended: {state.fault.name}")  # a driver has better words

    def silence_error(self, state: LinkState, note: str = "") -> RonnaError:
        """Build the error for a controller that has fallen silent."""
        return self.errors.silent(
            f"{self.name}: after {state.cycles} cycles no {self.errors.words.message} came for "
            f"{self.options.silence_limit_s:g} s{note}",
            expected=f"a {self.errors.words.message} in every cycle",
        )

    def refusal_error(self, state: LinkState) -> RefusedError | StateError:
        """Build the error for a motion that was refused, or stopped before it began."""
        if state.result is MotionResult.REFUSED_STOP:
            return self.errors.stopped(f"{self.name}: stopped before it began", got=self.axes_text(state))
        if state.result is MotionResult.REFUSED_LOADED:
            if not state.is_force_known:
                return LOADED_AT_START(
                    f"{self.name}: the force on the tool is not known: {SENSOR_SILENT}", action=LOOK_AT_SENSOR
                )
            axes = ", ".join(f"{axis} {value:.1f}" for axis, value in zip("xyz", state.force_N, strict=True))
            return LOADED_AT_START(
                f"{self.name}: a force acts on the tool at the start, or the arm has just come to rest",
                got=f"{math.hypot(*state.force_N):.1f} N ({axes} in the frame of the base)",
            )
        reason = _REFUSALS.get(state.result, f"result {state.result.name}")
        return self.errors.refused(f"{self.name}: the motion was refused: {reason}")

    def not_finished_error(self, initial: LinkState, state: LinkState, limit_s: float) -> LinkTimeout:
        """Build the error for a motion that did not end in time, with what slowed it: there, or losses."""
        share = state.speed_share / (DEGRADED_SPEED if state.degraded else 1.0)
        is_slowed = share < 1.0
        reason = f": {self.errors.words.speed} is at {share:.0%}" if is_slowed else ""
        return self.errors.not_finished(
            f"{self.name}: the motion did not end or settle{reason or self.losses_text(initial, state)}",
            limit=f"{limit_s:g} s",
            got=self.axes_text(state),
            action=self.errors.words.speed_action if is_slowed else None,
        )

    def force_error(self, state: LinkState, force: ForceLimit) -> ForceLimitExceeded:
        """Build the error for a motion that its force limit stopped, or a sensor that says nothing."""
        if not state.is_force_known:
            return ForceLimitExceeded(
                f"{self.name}: stopped at {self.axes_text(state)}, because {SENSOR_SILENT}",
                limit=f"{force.limit_N:g} N",
                got="no force",
                action=f"{ForceLimitExceeded.action} {LOOK_AT_SENSOR}",
            )
        if state.result is MotionResult.STALLED:
            return ForceLimitExceeded(
                f"{self.name}: the drill does not cut: its feed has rested for {LONGEST_REST_S:g} s under "
                f"the force, at {self.axes_text(state)}",
                limit=f"{force.limit_N:g} N",
                got=f"{state.peak_force_N:.1f} N",
                action=f"Check that the drill turns and is sharp. {ForceLimitExceeded.action}",
            )
        if state.result is MotionResult.ASIDE and force.drill is not None:
            return ForceLimitExceeded(
                f"{self.name}: a force across its axis pushes the drill, at {self.axes_text(state)}",
                limit=f"{force.drill.side_N:g} N across",
                got=f"{state.side_force_N:.1f} N",
                action="Switch the drill off. Look what presses on guide, drill or holder, and whether the "
                f"drill slides on oblique bone. {ForceLimitExceeded.action}",
            )
        if state.result is MotionResult.HIDDEN and force.drill is not None:
            return ForceLimitExceeded(
                f"{self.name}: a force across its axis hides whether bone resists the drill, at "
                f"{self.axes_text(state)}",
                limit=f"{force.drill.free_N:g} N along it, less {force.drill.friction:g} of the force across",
                got=f"up to {state.side_force_N:.1f} N across",
                action="Switch the drill off. The skull may be open there. Look what presses on guide, drill "
                f"or holder. {ForceLimitExceeded.action}",
            )
        return ForceLimitExceeded(
            f"{self.name}: the force on the tool stopped the motion at {self.axes_text(state)}",
            limit=f"{force.limit_N:g} N",
            got=f"{state.peak_force_N:.1f} N",
        )

    def losses_text(self, initial: LinkState, state: LinkState) -> str:
        """Describe the losses between two states, or return an empty text if there were none."""
        counts = attrgetter("cycles", "late", "lost")
        changes = zip(counts(state), counts(initial), strict=True)
        cycles, late, lost = (max(now - before, 0) for now, before in changes)
        if not late and not lost:
            return ""
        return (
            f": of {cycles} cycles {late} were late or lost by the controller's count, "
            f"{lost} by {self.errors.words.clock}"
        )

    def axes_text(self, state: LinkState) -> str:
        """Format the measured joint angles."""
        names = self.arm.axis_names
        angles = " ".join(f"{degrees(angle):.3f}" for angle in state.measured_rad)
        return f"{names[0]}..{names[-1]} {angles} deg"

    def furthest_text(self, state: LinkState) -> str:
        """Format the axis with the largest deviation from its set-point."""
        off_deg = [degrees(x - y) for x, y in zip(state.measured_rad, state.commanded_rad, strict=True)]
        axis = max(range(len(off_deg)), key=lambda k: abs(off_deg[k]))
        return f"{self.arm.axis_names[axis]} {off_deg[axis]:.4f} deg off its set-point"


def monitor_error(
    prefix: str,
    state: LinkState,
    arm: Kinematics,
    surroundings: Surroundings,
    mode: str,
    error: AnyCode[LimitError],
) -> LimitError:
    """Build the error for a limit that the monitor saw violated."""
    bodies = Bodies(arm, surroundings)
    kind, axis = ViolationKind(state.violation_kind), state.violation_axis
    violation = Violation(kind, axis, state.violation_value, state.violation_limit)
    limit = violation.format_value(violation.limit)
    if violation.is_axis_violation:
        subject = arm.axis_names[axis - 1]
    elif kind is ViolationKind.BODY_SPEED:
        subject = f"the {bodies.moving_names[axis]}" if axis < len(bodies.moving_names) else "a body"
    else:
        is_known = axis < len(bodies.pairs)
        subject = "{} and {}".format(*bodies.names(bodies.pairs[axis])) if is_known else "its bodies"
    if kind is ViolationKind.SPEED:
        share = violation.limit / arm.full_speed_rad_s[axis - 1]
        limit += f" ({share:.0%} of full speed in {mode})"
    elif kind is ViolationKind.BODY_SPEED:
        limit += f" in {mode}"
    what = ViolationKind.SPEED if kind is ViolationKind.BODY_SPEED else kind
    return error(
        f"{prefix} the monitor stopped the arm: {what} of {subject}",
        limit=limit,
        got=violation.format_value(violation.value),
    )
