"""Errors of the connection to a Universal Robots controller."""

from __future__ import annotations

from ronna_hw.arm_stream.errors import CommandRefused, MakeRow, MalformedMessage, StreamErrors, StreamWords
from ronna_hw.devices.errors import ACKNOWLEDGE
from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DataError,
    DeviceError,
    ErrorCode,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
)

# Dashboard guide, "unlock protective stop": it fails with a message before that.
UNLOCK_WAIT = "the controller releases a protective stop only 5 s after it"

SPEED_AT_ZERO = ErrorCode(
    "URD-011",
    RefusedError,
    "The speed slider is at zero: no motion would ever end.",
    "Raise the speed slider at the bottom of the pendant's screen.",
)

STREAM_ERRORS = StreamErrors(
    StreamWords(
        clock="timestamp",
        message="package",
        answers="set-points",
        stop="The script stops the arm.",
        speed="the speed slider",
        speed_action=SPEED_AT_ZERO.action,
    ),
    {
        "not_found": MakeRow(
            "URD-002",
            "No Universal Robots controller answers at an endpoint.",
            "Check the address and the cable, that the controller has started, and that Settings > Security "
            "allows its services dashboard, primary client and RTDE.",
        ),
        "lost": MakeRow("URD-014"),
        "no_answer": MakeRow("URD-015"),
        "not_started": MakeRow("URD-020"),
        "silent": MakeRow("URD-021"),
        "heartbeat_late": MakeRow("URD-023"),
        "died": MakeRow("URD-024"),
        "stalled": MakeRow("URD-025"),
        "tripped": MakeRow("URD-026"),
        "path_failed": MakeRow("URD-027"),
        "unusable": MakeRow(
            "URD-028",
            "Too many set-points came late for too long, so the arm was stopped.",
            "Find what loads the computer or the network to the controller, which must carry nothing else; "
            f"then {ACKNOWLEDGE}.",
        ),
        "protective_stop": MakeRow("URD-029"),
        "link_stopped": MakeRow(
            "URD-030", "Set-points were withheld on request, so that the script stops the arm."
        ),
        "drives_off": MakeRow("URD-031", "The arm was switched off on request, and a fault is latched."),
        "stopped": MakeRow("URD-032"),
        "not_finished": MakeRow(
            "URD-033", action="Check the speed slider and the lost cycles, or give the motion more time."
        ),
        "refused": MakeRow("URD-034"),
    },
)

BAD_OPTIONS = ErrorCode(
    "URD-001",
    ConfigurationError,
    "The arm options in the theatre file are invalid.",
    "Correct the listed options; docs/reference/ur-options.md describes them.",
)

WRONG_ARM = ErrorCode(
    "URD-003",
    ConnectError,
    "The arm at the endpoint has another model or serial number than the theatre file states.",
    "Correct the endpoints, or the options model and serial.",
)

WRONG_VERSION = ErrorCode(
    "URD-004",
    ConnectError,
    "The controller's software lacks what the driver needs.",
    "Update the controller: PolyScope 3.9 or newer on CB3, 5.6 or newer on the e-Series.",
)

FACTORY_CALIBRATION_DIFFERS = ErrorCode(
    "URD-005",
    ConnectError,
    "The controller's factory calibration is not the one that this theatre was measured with.",
    "Check that this is the arm of this theatre. If it has been exchanged or calibrated anew, repeat the "
    "calibrations of the theatre, then correct option calibration.",
)

LOCAL_MODE = ErrorCode(
    "URD-006",
    RefusedError,
    "The controller is not in remote control, so that it accepts no program.",
    "Choose remote control at the top right of the pendant's screen.",
)

EMERGENCY_STOPPED = ErrorCode(
    "URD-007",
    RefusedError,
    "An emergency stop is pressed.",
    "Release the emergency stop when the cell is safe, then start again.",
)

NOT_POWERED = ErrorCode(
    "URD-008",
    RefusedError,
    "The arm could not be switched on, or its brakes could not be released.",
    "Read the pendant's messages, and switch the arm on there (red button at the bottom left).",
)

PROTECTIVELY_STOPPED = ErrorCode(
    "URD-009",
    RefusedError,
    "The controller has stopped the arm for its protection, and nobody has acknowledged it.",
    f"Find the cause at the arm first: {UNLOCK_WAIT}. Then {ACKNOWLEDGE}.",
)

SAFETY_STOPPED = ErrorCode(
    "URD-010",
    RefusedError,
    "A safeguard, or a fault of the controller's safety system, prevents motion.",
    f"Reset the safeguard; after a violation or fault read the pendant's messages and {ACKNOWLEDGE}.",
)


class RegistersInUse(ConnectError):
    """Another client or a fieldbus owns the registers through which our script is driven."""

    code = "URD-012"
    action = "End the other client (another run, a fieldbus with these registers), then start again."


ANOTHER_PROGRAM_RUNS = ErrorCode(
    "URD-013",
    RefusedError,
    "The controller is running a program that this driver did not start.",
    "Check who started it, stop it at the pendant, then start again.",
)

BAD_BYTES = ErrorCode(
    "URD-016",
    MalformedMessage,
    "Bytes received from the controller are not what its guides describe.",
    "Check that the endpoint is of the right service of the controller, and report the bytes.",
)

COMMAND_REFUSED = ErrorCode(
    "URD-017",
    CommandRefused,
    "The controller refused a command of its dashboard.",
    "Read the pendant's messages.",
)

SCRIPT_NOT_STARTED = ErrorCode(
    "URD-018",
    DeviceError,
    "The controller did not start our script, or the script ended at once.",
    "Read the pendant's log page. If it has no message, the script did not arrive: check that endpoint "
    "primary is of this controller, and that Settings > Security allows the primary client interface.",
)

LINK_BROKEN = ErrorCode(
    "URD-022",
    ProtocolError,
    "The RTDE connection ended, or carried bytes that are no package, while the stream was running.",
    STREAM_ERRORS.silent.action,
)

CONTROLLER_STOPPED = ErrorCode(
    "URD-035",
    LimitError,
    "Emergency stop, safeguard, power or another safety mode interrupted a running stream.",
    f"Check the cell first. When the cause is removed, {ACKNOWLEDGE}.",
)

PROGRAM_STOPPED = ErrorCode(
    "URD-036",
    DeviceError,
    "Somebody stopped or paused our program, or started another one.",
    f"Check who did it at the pendant, then {ACKNOWLEDGE}.",
)

SCRIPT_STOPPED = ErrorCode(
    "URD-037",
    LinkTimeout,
    "Our script stopped the arm by itself: no set-point came in time, or one was too far away.",
    "Find what delayed the set-points: a busy computer (option starve_limit_s can allow more; start a "
    f"rehearsal with --lock-step), or the network. Then {ACKNOWLEDGE}.",
)

CONTROLLER_RESTARTED = ErrorCode(
    "URD-038",
    DeviceError,
    "The controller's time jumped: it is another run of the controller than at the start.",
    f"Check the controller, then {ACKNOWLEDGE}.",
)

POSE_IMPLAUSIBLE = ErrorCode(
    "URD-039",
    DeviceError,
    "At the start the arm is outside its joint ranges, or not where it is commanded to be.",
    f"Check that nothing touches the arm; bring it into its ranges at the pendant. Then {ACKNOWLEDGE}.",
)

LOAD_NOT_TAKEN = ErrorCode(
    "URD-040",
    RefusedError,
    "The controller does not use the mass, centre of gravity or tool centre point that were set.",
    "Read the pendant's messages, and set the payload again; without it the force is not known.",
)

BAD_LOAD = ErrorCode(
    "URD-041",
    DataError,
    "The load of a tool is not one that the arm can carry.",
    "Give the mass in kg, and places in mm in the frame of the flange.",
)

CONTROLLER_EXCHANGED = ErrorCode(
    "URD-042",
    ConnectError,
    "At a recovery another arm, software or factory calibration is found than was connected.",
    "Check which arm answers at the endpoints. Plans and calibrations hold for the first one only: end "
    "this run, and connect anew.",
)

PROTECTIVE_STOP = ErrorCode(
    "URD-043",
    LimitError,
    "The controller stopped the arm for its protection while the stream was running.",
    f"Look at arm and tool for what it touched, and read the pendant's message: {UNLOCK_WAIT}. "
    f"Then {ACKNOWLEDGE}.",
)

SWITCHED_TO_LOCAL = ErrorCode(
    "URD-044",
    LimitError,
    "Somebody switched the controller to local control at the pendant while the stream was running.",
    f"Ask who has the pendant, choose remote control at the top right of its screen, then {ACKNOWLEDGE}.",
)
