"""Errors of the robot connection: RSI codes for the stream, EKI codes for the EKI channel."""

from __future__ import annotations

from ronna_hw.arm_stream.errors import CommandRefused, MakeRow, MalformedMessage, StreamErrors, StreamWords
from ronna_hw.devices.errors import ACKNOWLEDGE
from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DeviceError,
    ErrorCode,
    LimitError,
    LinkTimeout,
    RefusedError,
)
from ronna_hw.wire.kuka_eki import PROJECT_PORT

EKI_LISTENS = (
    f"our EKI server listens on {PROJECT_PORT} by default, the control SDK's on 54600: check the endpoint"
)

STREAM_ERRORS = StreamErrors(
    StreamWords(
        clock="IPOC",
        message="telegram",
        answers="replies",
        stop="The controller stops the arm by its Timeout.",
    ),
    {
        "not_found": MakeRow(
            "EKI-001",
            "No KR C4 with our EKI server replies at the controller's address.",
            "Check the address, the cable, and that the EKI server program is running on the controller; "
            f"{EKI_LISTENS}.",
        ),
        "lost": MakeRow("EKI-002", "The connection to the controller broke."),
        "no_answer": MakeRow(
            "EKI-003",
            "The controller did not answer a command in time.",
            "Check that the submit interpreter of the controller runs; if the arm is in fault, "
            f"{ACKNOWLEDGE}.",
        ),
        "not_started": MakeRow(
            "RSI-001",
            "The real-time process did not start, or its port is in use.",
            "Free the port of endpoint rsi, or choose another one in the theatre file and the Ethernet file.",
        ),
        "silent": MakeRow(
            "RSI-003", action=f"Check the controller's message window and the cable, then {ACKNOWLEDGE}."
        ),
        "link_stopped": MakeRow(
            "RSI-004", "Replies were stopped on request, so that the controller's Timeout ends the stream."
        ),
        "tripped": MakeRow("RSI-005"),
        "heartbeat_late": MakeRow("RSI-006"),
        "died": MakeRow("RSI-007"),
        "protective_stop": MakeRow("RSI-009"),
        "stopped": MakeRow("RSI-010"),
        "not_finished": MakeRow("RSI-011"),
        "refused": MakeRow("RSI-012"),
        "path_failed": MakeRow("RSI-016"),
        "unusable": MakeRow(
            "RSI-019",
            "Too many replies were lost for too long, so the arm was stopped.",
            "Find what loads the computer or the RSI network (it must carry nothing else), then "
            f"{ACKNOWLEDGE}.",
        ),
        "stalled": MakeRow("RSI-020"),
        "drives_off": MakeRow("EKI-009"),
    },
)

NO_TELEGRAM = ErrorCode(
    "RSI-002",
    LinkTimeout,
    "The RSI program was started, but this computer receives no telegrams.",
    ("Check the address and port in the Ethernet file, the subnet of the RSI interface and the firewall."),
)

CONTROLLER_RESTARTED = ErrorCode(
    "RSI-008",
    DeviceError,
    "Telegrams come from an RSI run that this program did not start.",
    f"Check who started the program, then {ACKNOWLEDGE}.",
)

BAD_OPTIONS = ErrorCode(
    "RSI-013",
    ConfigurationError,
    "The arm options in the theatre file are invalid.",
    "Correct the listed options; docs/reference/robot-options.md describes them.",
)

BAD_TELEGRAM = ErrorCode(
    "RSI-014",
    MalformedMessage,
    "Bytes received from the controller are not a valid RSI telegram.",
    "Load the Ethernet file of this driver on the controller.",
)

POSE_DISAGREES = ErrorCode(
    "RSI-015",
    DeviceError,
    "RSI and EKI report different joint angles, so they belong to different controllers.",
    "Check that the endpoints rsi and eki_project belong to the same controller.",
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

BAD_EKI_TELEGRAM = ErrorCode(
    "EKI-004",
    MalformedMessage,
    "Bytes received from the controller are not a valid EKI telegram.",
    f"Look at the controller's message window, then {ACKNOWLEDGE}. If it repeats, load the EKI file of "
    "this driver on the controller.",
)

WRONG_CONTROLLER = ErrorCode(
    "EKI-005",
    ConnectError,
    "The controller's RSI context, cycle, corrections or arm differ from the driver's configuration.",
    "Load the files of drivers/kuka_rsi/controller on the controller, or correct the options variant, "
    "cycle_ms and context.",
)

UNVERIFIED_CONTROLLER = ErrorCode(
    "EKI-006",
    ConnectError,
    "The controller does not report which RSI context it runs.",
    "Load the EKI program of this driver, which reports it; or set option accept_unverified and confirm "
    "the start (a case prompts for it; otherwise activate_unverified(confirmed_by)): a micro-move then "
    "verifies it.",
)

CONTROLLER_NOT_READY = ErrorCode(
    "EKI-007",
    RefusedError,
    "Operating mode, drives, emergency stop, guard or an active message prevent motion.",
    "Release the emergency stop, close the guard, select EXT (a case asks before a start in T1; in "
    f"Python: allow_t1); then {ACKNOWLEDGE}.",
)

COMMAND_REFUSED = ErrorCode(
    "EKI-008",
    CommandRefused,
    "The controller refused a command.",
    "Look up the code, and read the controller's message window.",
)

CONTROLLER_STOPPED = ErrorCode(
    "EKI-010",
    LimitError,
    "Emergency stop, guard, mode, drives or a message interrupted a running stream and stopped the arm.",
    f"Check the cell first. When the cause is removed, {ACKNOWLEDGE}.",
)
