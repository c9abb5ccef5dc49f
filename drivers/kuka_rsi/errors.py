"""Errors of the robot connection: RSI codes for the stream, EKI codes for the EKI channel."""

from __future__ import annotations

from ronna_hw.arm_stream.errors import StreamErrors
from ronna_hw.devices.errors import ACKNOWLEDGE, MotionInterrupted
from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DeviceError,
    ErrorCode,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
    StateError,
)
from ronna_hw.wire.kuka_eki import PROJECT_PORT

LINK_NOT_STARTED = ErrorCode(
    "RSI-001",
    ConnectError,
    "The real-time process did not start, or its port is in use.",
    "Free the port of endpoint rsi, or choose another one in the theatre file and the Ethernet file.",
)


class NoTelegram(LinkTimeout):
    """The RSI program was started, but this computer receives no telegrams."""

    code = "RSI-002"
    action = (
        "Check the address and port in the Ethernet file, the subnet of the RSI interface and the firewall."
    )


LINK_SILENT = ErrorCode(
    "RSI-003",
    LinkTimeout,
    "Telegrams stopped arriving while the stream was running.",
    f"Check the controller's message window and the cable, then {ACKNOWLEDGE}.",
)


LINK_STOPPED = ErrorCode(
    "RSI-004",
    StateError,
    "Replies were stopped on request, so that the controller's Timeout ends the stream.",
    f"Find the reason, then {ACKNOWLEDGE}.",
)


MOTION_TRIPPED = ErrorCode(
    "RSI-005",
    LimitError,
    "The monitor stopped the arm.",
    f"Read the recorded cycles, find the cause, then {ACKNOWLEDGE}.",
)


HEARTBEAT_LATE = ErrorCode(
    "RSI-006",
    LinkTimeout,
    "This program's heartbeat to the real-time process was late, so the arm was stopped.",
    f"Reduce the computer's load, or find what blocked the program; then {ACKNOWLEDGE}.",
)


LINK_PROCESS_DIED = ErrorCode(
    "RSI-007",
    DeviceError,
    "The real-time process terminated unexpectedly.",
    f"The controller stops the arm by its Timeout. Then {ACKNOWLEDGE}. Report the message if it repeats.",
)


CONTROLLER_RESTARTED = ErrorCode(
    "RSI-008",
    DeviceError,
    "Telegrams come from an RSI run that this program did not start.",
    f"Check who started the program, then {ACKNOWLEDGE}.",
)


PROTECTIVE_STOP = ErrorCode(
    "RSI-009",
    StateError,
    "A protective stop was requested; it remains latched.",
    f"Find the reason, then {ACKNOWLEDGE}.",
)


MOTION_STOPPED = ErrorCode(
    "RSI-010",
    MotionInterrupted,
    "A motion was stopped before its end, with the arm at rest on its path.",
    "Resume and plan a new motion from here; an interrupted path is not continued.",
)


MOTION_NOT_FINISHED = ErrorCode(
    "RSI-011",
    LinkTimeout,
    "The motion did not end, or the arm did not settle, within the time limit.",
    "Give the motion more time, or check the lost cycles and option settle_tolerance_deg.",
)


MOTION_REFUSED = ErrorCode(
    "RSI-012",
    RefusedError,
    "The real-time process refused a motion.",
    "Wait for the current motion to end, and plan from the arm's current pose.",
)


BAD_OPTIONS = ErrorCode(
    "RSI-013",
    ConfigurationError,
    "The arm options in the theatre file are invalid.",
    "Correct the listed options; docs/reference/robot-options.md describes them.",
)


class BadTelegram(ProtocolError):
    """Bytes received from the controller are not a valid RSI telegram."""

    code = "RSI-014"
    action = "Load the Ethernet file of this driver on the controller."


class PoseDisagrees(DeviceError):
    """RSI and EKI report different joint angles, so they belong to different controllers."""

    code = "RSI-015"
    action = "Check that the endpoints rsi and eki_project belong to the same controller."


PATH_FAILED = ErrorCode(
    "RSI-016",
    LimitError,
    "The path had no solution at some point, so the arm was stopped in joint space.",
    f"First {ACKNOWLEDGE}. Then move away from the singular pose by a joint move.",
)


CONTEXT_UNUSABLE = ErrorCode(
    "RSI-017",
    ConfigurationError,
    "The RSI context is unsafe or insufficient for this driver.",
    "Correct the listed entries, then generate and load the controller's files again.",
)


HANDSHAKE_FAILED = ErrorCode(
    "RSI-018",
    DeviceError,
    "An unverified controller failed the micro-move test.",
    "Load the files of drivers/kuka_rsi/controller on the controller before moving the arm.",
)


LINK_UNUSABLE = ErrorCode(
    "RSI-019",
    LinkTimeout,
    "Too many replies were lost for too long, so the arm was stopped.",
    f"Find what loads the computer or the RSI network (it must carry nothing else), then {ACKNOWLEDGE}.",
)


LINK_PROCESS_STALLED = ErrorCode(
    "RSI-020",
    DeviceError,
    "The real-time process is running but stalled, so the controller gets no replies.",
    (
        "The controller stops the arm by its Timeout. Find what blocks the process or the computer; "
        f"then {ACKNOWLEDGE}. A new process is started."
    ),
)


EKI_LISTENS = (
    f"our EKI server listens on {PROJECT_PORT} by default, the control SDK's on 54600: check the endpoint"
)


class ControllerNotFound(ConnectError):
    """No KR C4 with our EKI server replies at the controller's address."""

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
    """The controller did not answer a command in time."""

    code = "EKI-003"
    action = (
        f"Check that the submit interpreter of the controller runs; if the arm is in fault, {ACKNOWLEDGE}."
    )


class BadEkiTelegram(ProtocolError):
    """Bytes received from the controller are not a valid EKI telegram."""

    code = "EKI-004"
    action = (
        f"Look at the controller's message window, then {ACKNOWLEDGE}. If it repeats, load the EKI file of "
        "this driver on the controller."
    )


WRONG_CONTROLLER = ErrorCode(
    "EKI-005",
    ConnectError,
    "The controller's RSI context, cycle, corrections or arm differ from the driver's configuration.",
    (
        "Load the files of drivers/kuka_rsi/controller on the controller, or correct the options variant, "
        "cycle_ms and context."
    ),
)


UNVERIFIED_CONTROLLER = ErrorCode(
    "EKI-006",
    ConnectError,
    "The controller does not report which RSI context it runs.",
    (
        "Load the EKI program of this driver, which reports it; or set option accept_unverified and confirm "
        "the start (a case prompts for it; otherwise activate_unverified(confirmed_by)): a micro-move then "
        "verifies it."
    ),
)


CONTROLLER_NOT_READY = ErrorCode(
    "EKI-007",
    RefusedError,
    "Operating mode, drives, emergency stop, guard or an active message prevent motion.",
    (
        "Release the emergency stop, close the guard, select EXT (a case asks before a start in T1; in "
        f"Python: allow_t1); then {ACKNOWLEDGE}."
    ),
)


class CommandRefused(DeviceError):
    """The controller refused a command."""

    code = "EKI-008"
    action = "Look up the code, and read the controller's message window."


DRIVES_OFF = ErrorCode(
    "EKI-009",
    StateError,
    "The drives were switched off on request, and a fault is latched.",
    f"Find the reason, then {ACKNOWLEDGE}.",
)


class ControllerStopped(LimitError):
    """Emergency stop, guard, mode, drives or a message interrupted a running stream and stopped the arm."""

    code = "EKI-010"
    action = f"Check the cell first. When the cause is removed, {ACKNOWLEDGE}."


STREAM_ERRORS = StreamErrors(
    not_found=ControllerNotFound,
    lost=ControllerLost,
    no_answer=NoAnswer,
    not_started=LINK_NOT_STARTED,
    died=LINK_PROCESS_DIED,
    stalled=LINK_PROCESS_STALLED,
    silent=LINK_SILENT,
    heartbeat_late=HEARTBEAT_LATE,
    tripped=MOTION_TRIPPED,
    path_failed=PATH_FAILED,
    unusable=LINK_UNUSABLE,
    protective_stop=PROTECTIVE_STOP,
    link_stopped=LINK_STOPPED,
    drives_off=DRIVES_OFF,
    stopped=MOTION_STOPPED,
    not_finished=MOTION_NOT_FINISHED,
    refused=MOTION_REFUSED,
    clock_name="IPOC",
    message_name="telegram",
)
