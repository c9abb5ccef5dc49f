"""Errors of the robot link: RSI codes for the stream, EKI codes for the other channel."""

from __future__ import annotations

from ronna_hw.devices.errors import ACKNOWLEDGE, MotionInterrupted
from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DeviceError,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
    StateError,
)
from ronna_hw.wire.kuka_eki import PROJECT_PORT


class LinkNotStarted(ConnectError):
    """The real-time process did not start, or its port is taken."""

    code = "RSI-001"
    action = "Free the port of endpoint rsi, or choose another one in the theatre file and the Ethernet file."


class NoTelegram(LinkTimeout):
    """The controller was started but sends no telegrams to this computer."""

    code = "RSI-002"
    action = (
        "Check the address and port in the Ethernet file, the subnet of the RSI interface and the firewall."
    )


class LinkSilent(LinkTimeout):
    """Telegrams stopped arriving while the stream was running."""

    code = "RSI-003"
    action = f"Check the controller's message window and the cable, then {ACKNOWLEDGE}."


class LinkStopped(StateError):
    """Replies were stopped on request, so that the controller's Timeout ends the stream."""

    code = "RSI-004"
    action = f"Find the reason, then {ACKNOWLEDGE}."


class MotionTripped(LimitError):
    """The monitor stopped the arm."""

    code = "RSI-005"
    action = f"Read the recorded cycles, find the cause, then {ACKNOWLEDGE}."


class HeartbeatLate(LinkTimeout):
    """The real-time process received no heartbeat from this program and stopped the arm."""

    code = "RSI-006"
    action = f"Reduce the computer's load, or find what blocked the program; then {ACKNOWLEDGE}."


class LinkProcessDied(DeviceError):
    """The real-time process ended by itself."""

    code = "RSI-007"
    action = (
        f"The controller stops the arm by its Timeout. Then {ACKNOWLEDGE}. Report the message if it repeats."
    )


class ControllerRestarted(DeviceError):
    """Telegrams come from a program run that this program did not start."""

    code = "RSI-008"
    action = f"Check who started the program, then {ACKNOWLEDGE}."


class ProtectiveStop(StateError):
    """A protective stop was requested and is latched."""

    code = "RSI-009"
    action = f"Find the reason, then {ACKNOWLEDGE}."


class MotionStopped(MotionInterrupted):
    """A motion was stopped before its end; the arm is at rest on its path."""

    code = "RSI-010"
    action = "Resume and plan a new motion from here; an interrupted path is not continued."


class MotionNotFinished(LinkTimeout):
    """A motion did not end, or the arm did not settle, within its time limit."""

    code = "RSI-011"
    action = "Give the motion more time, or check the lost cycles and option settle_tolerance_deg."


class MotionRefused(RefusedError):
    """The real-time process refused a motion."""

    code = "RSI-012"
    action = "Wait for the current motion to end, and plan from the arm's current pose."


class BadOptions(ConfigurationError):
    """The driver's options in the theatre file are wrong."""

    code = "RSI-013"
    action = "Correct the listed options; docs/reference/robot-options.md describes them."


class BadTelegram(ProtocolError):
    """Bytes from the controller are not a valid telegram."""

    code = "RSI-014"
    action = "Load the Ethernet file of this driver on the controller."


class PoseDisagrees(DeviceError):
    """RSI and EKI report different axes, so they do not belong to the same controller."""

    code = "RSI-015"
    action = "Check that the endpoints rsi and eki_project belong to the same controller."


class PathFailed(LimitError):
    """A path had no solution at some point, and the arm was stopped in joint space."""

    code = "RSI-016"
    action = f"First {ACKNOWLEDGE}. Then move away from the singular pose by a joint move."


class ContextUnusable(ConfigurationError):
    """The RSI context is unsafe, or reports too little, for this driver."""

    code = "RSI-017"
    action = "Correct the listed entries, then generate and load the controller's files again."


class HandshakeFailed(DeviceError):
    """An unverified controller did not move as commanded in the micro-move."""

    code = "RSI-018"
    action = "Load the files of drivers/kuka_rsi/controller on the controller before moving the arm."


class LinkUnusable(LinkTimeout):
    """Too many replies were lost for too long, and the arm was stopped."""

    code = "RSI-019"
    action = (
        f"Find what loads the computer or the RSI network (it must carry nothing else), then {ACKNOWLEDGE}."
    )


class LinkProcessStalled(DeviceError):
    """The real-time process is alive but stalled for too long: the controller gets no replies."""

    code = "RSI-020"
    action = (
        "The controller stops the arm by its Timeout. Find what blocks the process or the computer; "
        f"then {ACKNOWLEDGE}. A new process is started."
    )


EKI_LISTENS = (
    f"our EKI server listens on {PROJECT_PORT} by default, the control SDK's on 54600: check the endpoint"
)


class ControllerNotFound(ConnectError):
    """Nothing answers at the controller's address, or the answer is not an expected telegram."""

    code = "EKI-001"
    action = (
        "Check the address, the cable, and that the EKI server program is running on the controller; "
        f"{EKI_LISTENS}."
    )


class ControllerLost(ProtocolError):
    """The connection to the controller broke."""

    code = "EKI-002"
    action = f"To open a new connection and read everything again, {ACKNOWLEDGE}."


class NoAnswer(LinkTimeout):
    """A command was not answered in time."""

    code = "EKI-003"
    action = (
        f"Check that the submit interpreter of the controller runs; if the arm is in fault, {ACKNOWLEDGE}."
    )


class BadEkiTelegram(ProtocolError):
    """Bytes from the controller are not a valid telegram."""

    code = "EKI-004"
    action = (
        f"Look at the controller's message window, then {ACKNOWLEDGE}. If it repeats, load the EKI file of "
        "this driver on the controller."
    )


class WrongController(ConnectError):
    """The controller's context, cycle, mode or arm differs from the driver's configuration."""

    code = "EKI-005"
    action = (
        "Load the files of drivers/kuka_rsi/controller on the controller, or correct the options variant, "
        "cycle_ms and context."
    )


class Unverified(ConnectError):
    """The controller does not report which context it runs."""

    code = "EKI-006"
    action = (
        "Load the EKI program of this driver, which reports it; or set option accept_unverified and confirm "
        "the start (a case prompts for it; otherwise activate_unverified(confirmed_by)): a micro-move then "
        "verifies it."
    )


class ControllerNotReady(RefusedError):
    """Mode, drives, emergency stop, guard or an active message forbid motion."""

    code = "EKI-007"
    action = (
        f"Release the emergency stop, close the guard, select EXT (T1 needs allow_t1); then {ACKNOWLEDGE}."
    )


class CommandRefused(DeviceError):
    """The controller refused a command."""

    code = "EKI-008"
    action = "Look up the code, and read the controller's message window."


class DrivesOff(StateError):
    """The drives were switched off on request; the fault is latched."""

    code = "EKI-009"
    action = f"Find the reason, then {ACKNOWLEDGE}."


class ControllerStopped(LimitError):
    """Emergency stop, guard, mode, drives or a message ended a running stream; the arm was stopped."""

    code = "EKI-010"
    action = f"Check the cell first. When the cause is removed, {ACKNOWLEDGE}."
