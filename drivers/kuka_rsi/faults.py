"""Turns what the real-time process reports into the error that is raised and latched."""

from __future__ import annotations

from math import degrees

from drivers.kuka_rsi.errors import (
    ControllerRestarted,
    DrivesOff,
    HeartbeatLate,
    LinkSilent,
    LinkStopped,
    MotionRefused,
    MotionTripped,
    PathFailed,
    PoseDisagrees,
    ProtectiveStop,
    RecordedCycle,
)
from drivers.kuka_rsi.link_state import Fault, LinkState, Result
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.errors import RonnaError

_REFUSALS = {
    Result.REFUSED_BUSY: "another motion is under way",
    Result.REFUSED_START: "it was planned from another pose than the last one sent",
    Result.REFUSED_PHASE: "no correction stream is running",
    Result.REFUSED_NUMBERS: "no profile exists for its numbers",
    Result.REFUSED_STOP: "a stop was asked for after it was planned",
}


def error_of_fault(
    name: str,
    state: LinkState,
    options: KukaOptions,
    cycles: tuple[RecordedCycle, ...] = (),
    message: int = 0,
) -> RonnaError | None:
    """The error of the latched fault, or None when there is none. `message`: the controller's, 0 for none."""
    where = f"{name}: after {state.cycles} cycles"
    match state.fault:
        case Fault.NONE:
            return None
        case Fault.MONITOR:
            tripped = MotionTripped(
                f"{where} the monitor stopped the arm: {state.violation_kind} of A{state.violation_axis}",
                limit=f"{degrees(state.violation_limit):.4f} deg",
                last=f"{degrees(state.violation_value):.4f} deg",
            )
            tripped.cycles = cycles
            return tripped
        case Fault.SILENCE:
            said = f"; the controller shows message {message}" if message else ""
            return LinkSilent(
                f"{where} telegrams ceased{said}",
                awaited="a telegram in every cycle",
                limit=f"{options.silence_limit_s:g} s",
                last=f"IPOC {state.IPOC}",
            )
        case Fault.HEARTBEAT:
            return HeartbeatLate(
                f"{where} this program's heartbeat was late", limit=f"{options.heartbeat_limit_s:g} s"
            )
        case Fault.PROTECTIVE:
            return ProtectiveStop(f"{name}: a protective stop was asked for")
        case Fault.LINK_STOP:
            return LinkStopped(f"{name}: replies were ceased on request")
        case Fault.DRIVES_OFF:
            return DrivesOff(f"{name}: the drives were switched off on request")
        case Fault.PATH:
            return PathFailed(f"{where} the path had no solution")
        case Fault.RESTARTED:
            return ControllerRestarted(f"{where} telegrams of another run came", last=f"IPOC {state.IPOC}")
        case Fault.BASE:
            return PoseDisagrees(
                f"{name}: the first telegram's axes are outside the joint ranges",
                last=axes_text(state),
            )


def error_of_refusal(name: str, state: LinkState) -> MotionRefused:
    """The error of a motion that the real-time process did not accept."""
    why = _REFUSALS.get(state.result, f"result {state.result.name}")
    return MotionRefused(f"{name}: the motion was refused: {why}")


def axes_text(state: LinkState) -> str:
    """The measured axes for a message."""
    return "A1..A6 " + " ".join(f"{degrees(angle):.3f}" for angle in state.measured_rad) + " deg"
