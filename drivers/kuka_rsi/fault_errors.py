"""Conversion of faults from the real-time process to errors with a flight record."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

from drivers.kuka_rsi.errors import (
    ControllerRestarted,
    DrivesOff,
    HeartbeatLate,
    LinkSilent,
    LinkStopped,
    LinkUnusable,
    MotionRefused,
    MotionStopped,
    MotionTripped,
    NoTelegram,
    PathFailed,
    PoseDisagrees,
    ProtectiveStop,
)
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.link_health import AXES_AGREE_DEG, UNUSABLE_SHARE, WINDOW_CYCLES
from drivers.kuka_rsi.realtime.link_state import (
    AXIS_NAMES,
    NO_STATE,
    NOTHING_AROUND,
    Fault,
    LinkState,
    RecordedCycle,
    Result,
)
from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.live_watch import Violation, ViolationKind
from ronna_hw.arm.kr6_r900 import Kr6R900, kr6_r900
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector
from ronna_hw.wire.kuka_eki import OperationMode

FILE_NAME = "flight-record-{arm}.txt"
_REFUSALS = {
    Result.REFUSED_BUSY: "another motion is running",
    Result.REFUSED_START: "it was planned from a pose other than the last one sent",
    Result.REFUSED_PHASE: "no correction stream is running",
    Result.REFUSED_NUMBERS: "no motion profile exists for its values",
}
_HEAD = ("cycle", "IPOC", "ms", "turnaround us", "choice")


def fault_error(
    name: str,
    state: LinkState,
    options: KukaOptions,
    mode: OperationMode,
    message: int = 0,
    surroundings: Surroundings = NOTHING_AROUND,
) -> RonnaError | None:
    """Build the error for a latched fault, if any; `message` is the controller's number, 0 for none."""
    prefix = f"{name}: after {state.cycles} cycles"
    match state.fault:
        case Fault.NONE:
            return None
        case Fault.MONITOR:
            return _monitor_error(prefix, state, kr6_r900(options.variant), surroundings, mode)
        case Fault.SILENCE:
            message_text = f"; the controller shows message {message}" if message else ""
            return LinkSilent(
                f"{prefix} telegrams stopped{message_text}",
                expected="a telegram in every cycle",
                limit=f"{options.silence_limit_s:g} s",
                got=f"IPOC {state.IPOC}",
            )
        case Fault.HEARTBEAT:
            return HeartbeatLate(
                f"{prefix} this program's heartbeat was late", limit=f"{options.heartbeat_limit_s:g} s"
            )
        case Fault.PROTECTIVE:
            return ProtectiveStop(f"{name}: a protective stop was requested")
        case Fault.LINK_STOP:
            return LinkStopped(f"{name}: replies were stopped on request")
        case Fault.DRIVES_OFF:
            return DrivesOff(f"{name}: the drives were switched off on request")
        case Fault.PATH:
            return PathFailed(f"{prefix} the path had no solution")
        case Fault.RESTARTED:
            sender = f" from {state.foreign_host}" if state.foreign else ""
            return ControllerRestarted(
                f"{prefix} received telegrams of another run{sender}",
                got=f"IPOC {state.IPOC}",
            )
        case Fault.LOSSES:
            return LinkUnusable(
                f"{prefix} too few replies were accepted{losses_text(NO_STATE, state)}",
                limit=f"{UNUSABLE_SHARE:.0%} of {WINDOW_CYCLES} cycles, in two consecutive windows",
            )
        case Fault.BASE:
            return PoseDisagrees(
                f"{name}: the first telegram's axes are outside the joint ranges",
                got=axes_text(state),
            )


def start_error(
    name: str, state: LinkState, axes_deg: JointVector, options: KukaOptions, timeout_s: float
) -> NoTelegram | PoseDisagrees:
    """Build the error for a stream that received no matching telegram, with counts of all others."""
    last = f", the last from {state.foreign_host}" if state.foreign_host else ""
    counts = (
        (state.disagreeing, "reported other axes"),
        (state.foreign, "came from elsewhere"),
        (state.rejected, "were malformed or of another Type"),
    )
    sender_counts = ", ".join(f"{count} {what}" for count, what in counts if count)
    others = f"; {sender_counts}{last}" if sender_counts else ""
    limit = f"{timeout_s:g} s"
    if not state.disagreeing:
        return NoTelegram(
            f"{name}: the RSI program runs, but none of its telegrams arrive here{others}",
            expected=f"telegrams of {options.controller_host}" if options.controller_host else None,
            limit=limit,
        )
    pairs = [(by_eki, degrees(angle)) for by_eki, angle in zip(axes_deg, state.measured_rad, strict=True)]
    axis = max(range(len(pairs)), key=lambda k: abs(pairs[k][0] - pairs[k][1]))
    by_eki, by_rsi = pairs[axis]
    return PoseDisagrees(
        f"{name}: A{axis + 1} is {by_eki:.3f} deg by EKI and {by_rsi:.3f} by RSI{others}",
        expected=f"a telegram within {AXES_AGREE_DEG} deg of the axes by EKI",
        limit=limit,
    )


def _monitor_error(
    prefix: str, state: LinkState, arm: Kr6R900, surroundings: Surroundings, mode: OperationMode
) -> MotionTripped:
    bodies = Bodies(arm, surroundings)
    kind, axis = ViolationKind(state.violation_kind), state.violation_axis
    violation = Violation(kind, axis, state.violation_value, state.violation_limit)
    limit = violation.format_value(violation.limit)
    if violation.is_axis_violation:
        subject = f"A{axis}"
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
    return MotionTripped(
        f"{prefix} the monitor stopped the arm: {what} of {subject}",
        limit=limit,
        got=violation.format_value(violation.value),
    )


def refusal_error(name: str, state: LinkState) -> MotionRefused | MotionStopped:
    """Build the error for a motion that was refused, or stopped before it began."""
    if state.result is Result.REFUSED_STOP:
        return MotionStopped(f"{name}: stopped before it began", got=axes_text(state))
    reason = _REFUSALS.get(state.result, f"result {state.result.name}")
    return MotionRefused(f"{name}: the motion was refused: {reason}")


def losses_text(initial: LinkState, state: LinkState) -> str:
    """Describe the losses between two states, or return an empty text if there were none."""
    cycles, late, lost = (
        max(now - before, 0)
        for now, before in (
            (state.cycles, initial.cycles),
            (state.late, initial.late),
            (state.lost, initial.lost),
        )
    )
    if not late and not lost:
        return ""
    return f": of {cycles} cycles {late} were late or lost by the controller's count, {lost} by IPOC"


def axes_text(state: LinkState) -> str:
    """Format the measured joint angles."""
    return "A1..A6 " + " ".join(f"{degrees(angle):.3f}" for angle in state.measured_rad) + " deg"


def furthest_text(state: LinkState) -> str:
    """Format the axis with the largest deviation from its set-point."""
    off_deg = [degrees(x - y) for x, y in zip(state.measured_rad, state.commanded_rad, strict=True)]
    axis = max(range(len(off_deg)), key=lambda k: abs(off_deg[k]))
    return f"A{axis + 1} {off_deg[axis]:.4f} deg off its set-point"


def attach_flight_record(error: RonnaError, arm: str, cycles: Sequence[RecordedCycle]) -> None:
    """Attach the last cycles to an error, as a file for the run folder."""
    if cycles:
        title = f"{arm}: the last {len(cycles)} cycles before {error}"
        error.attachments[FILE_NAME.format(arm=arm)] = flight_table(cycles, title)


def flight_table(cycles: Sequence[RecordedCycle], title: str) -> str:
    """Format cycles as a table, oldest first; times in ms before the last cycle, angles in deg."""
    columns = (
        *_HEAD,
        *(f"{axis} measured" for axis in AXIS_NAMES),
        *(f"{axis} sent" for axis in AXIS_NAMES),
        *(f"{axis} behind" for axis in AXIS_NAMES),
    )
    rows = [_format_row(cycle, cycles[-1].received_ns) for cycle in cycles]
    widths = [max(len(text) for text in column) for column in zip(columns, *rows, strict=True)]
    lines = [title, ""]
    for row in (columns, *rows):
        lines.append("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)))
    return "\n".join(lines) + "\n"


def _format_row(cycle: RecordedCycle, last_ns: int) -> tuple[str, ...]:
    behind = [s - m for s, m in zip(cycle.sent_rad, cycle.measured_rad, strict=True)]
    return (
        str(cycle.cycle),
        str(cycle.IPOC),
        f"{(cycle.received_ns - last_ns) / 1e6:.2f}",
        f"{cycle.turnaround_us:.1f}",
        cycle.choice.name.lower(),
        *_format_degrees(cycle.measured_rad),
        *_format_degrees(cycle.sent_rad),
        *(f"{degrees(angle):.4f}" for angle in behind),
    )


def _format_degrees(joints_rad: JointVector) -> tuple[str, ...]:
    return tuple(f"{degrees(angle):.4f}" for angle in joints_rad)
