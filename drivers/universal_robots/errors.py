"""Errors of the connection to a Universal Robots controller."""

from __future__ import annotations

from ronna_hw.arm_stream.errors import StreamErrors
from ronna_hw.devices.errors import ACKNOWLEDGE, MotionInterrupted
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
    StateError,
)

BAD_OPTIONS = ErrorCode(
    "URD-001",
    ConfigurationError,
    "The arm options in the theatre file are invalid.",
    "Correct the listed options; docs/reference/ur-options.md describes them.",
)


class ControllerNotFound(ConnectError):
    """No Universal Robots controller answers at an endpoint."""

    code = "URD-002"
    action = (
        "Check the address and the cable, that the controller has started, and that Settings > Security "
        "allows its services dashboard, primary client and RTDE."
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
    (
        "Check that this is the arm of this theatre. If it has been exchanged or calibrated anew, repeat the "
        "calibrations of the theatre, then correct option calibration."
    ),
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
    f"Find the cause at the arm first, and wait for 5 s. Then {ACKNOWLEDGE}.",
)


SAFETY_STOPPED = ErrorCode(
    "URD-010",
    RefusedError,
    "A safeguard, or a fault of the controller's safety system, prevents motion.",
    f"Reset the safeguard; after a violation or fault read the pendant's messages and {ACKNOWLEDGE}.",
)


SPEED_AT_ZERO = ErrorCode(
    "URD-011",
    RefusedError,
    "The speed slider is at zero: no motion would ever end.",
    "Raise the speed slider at the bottom of the pendant's screen.",
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


class ControllerLost(ProtocolError):
    """A connection to the controller broke."""

    code = "URD-014"
    action = f"To open a new connection and read everything again, {ACKNOWLEDGE}."


class NoAnswer(LinkTimeout):
    """The controller did not answer in time."""

    code = "URD-015"
    action = f"Check that the controller's software runs; if the arm is in fault, {ACKNOWLEDGE}."


class BadBytes(ProtocolError):
    """Bytes received from the controller are not what its guides describe."""

    code = "URD-016"
    action = "Check that the endpoint is of the right service of the controller, and report the bytes."


class CommandRefused(DeviceError):
    """The controller refused a command of its dashboard."""

    code = "URD-017"
    action = "Read the pendant's messages."


SCRIPT_NOT_STARTED = ErrorCode(
    "URD-018",
    DeviceError,
    "The controller did not start our script, or the script ended at once.",
    (
        "Read the pendant's log page. If it has no message, the script did not arrive: check that endpoint "
        "primary is of this controller, and that Settings > Security allows the primary client interface."
    ),
)


LINK_NOT_STARTED = ErrorCode(
    "URD-020",
    ConnectError,
    "The real-time process did not start.",
    "Check the computer's memory and process limits, then start again.",
)


LINK_SILENT = ErrorCode(
    "URD-021",
    LinkTimeout,
    "Packages stopped arriving while the stream was running.",
    f"The script stops the arm. Check the cable and the controller, then {ACKNOWLEDGE}.",
)


class LinkBroken(ProtocolError):
    """The RTDE connection ended, or carried bytes that are no package, while the stream was running."""

    code = "URD-022"
    action = f"The script stops the arm. Check the cable and the controller, then {ACKNOWLEDGE}."


HEARTBEAT_LATE = ErrorCode(
    "URD-023",
    LinkTimeout,
    "This program's heartbeat to the real-time process was late, so the arm was stopped.",
    f"Reduce the computer's load, or find what blocked the program; then {ACKNOWLEDGE}.",
)


LINK_PROCESS_DIED = ErrorCode(
    "URD-024",
    DeviceError,
    "The real-time process terminated unexpectedly.",
    f"The script stops the arm. Then {ACKNOWLEDGE}. Report the message if it repeats.",
)


LINK_PROCESS_STALLED = ErrorCode(
    "URD-025",
    DeviceError,
    "The real-time process is running but stalled, so the controller gets no set-points.",
    (
        "The script stops the arm. Find what blocks the process or the computer; "
        f"then {ACKNOWLEDGE}. A new process is started."
    ),
)


MOTION_TRIPPED = ErrorCode(
    "URD-026",
    LimitError,
    "The monitor stopped the arm.",
    f"Read the recorded cycles, find the cause, then {ACKNOWLEDGE}.",
)


PATH_FAILED = ErrorCode(
    "URD-027",
    LimitError,
    "The path had no solution at some point, so the arm was stopped in joint space.",
    f"First {ACKNOWLEDGE}. Then move away from the singular pose by a joint move.",
)


LINK_UNUSABLE = ErrorCode(
    "URD-028",
    LinkTimeout,
    "Too many set-points came late for too long, so the arm was stopped.",
    (
        f"Find what loads the computer or the network to the controller, which must carry nothing else; "
        f"then {ACKNOWLEDGE}."
    ),
)


PROTECTIVE_STOP = ErrorCode(
    "URD-029",
    StateError,
    "A protective stop was requested; it remains latched.",
    f"Find the reason, then {ACKNOWLEDGE}.",
)


LINK_STOPPED = ErrorCode(
    "URD-030",
    StateError,
    "Set-points were withheld on request, so that the script stops the arm.",
    f"Find the reason, then {ACKNOWLEDGE}.",
)


DRIVES_OFF = ErrorCode(
    "URD-031",
    StateError,
    "The arm was switched off on request, and a fault is latched.",
    f"Find the reason, then {ACKNOWLEDGE}.",
)


MOTION_STOPPED = ErrorCode(
    "URD-032",
    MotionInterrupted,
    "A motion was stopped before its end, with the arm at rest on its path.",
    "Resume and plan a new motion from here; an interrupted path is not continued.",
)


MOTION_NOT_FINISHED = ErrorCode(
    "URD-033",
    LinkTimeout,
    "The motion did not end, or the arm did not settle, within the time limit.",
    "Check the speed slider and the lost cycles, or give the motion more time.",
)


MOTION_REFUSED = ErrorCode(
    "URD-034",
    RefusedError,
    "The real-time process refused a motion.",
    "Wait for the current motion to end, and plan from the arm's current pose.",
)


class ControllerStopped(LimitError):
    """Emergency stop, safeguard, protective stop, power or the control mode interrupted a running stream."""

    code = "URD-035"
    action = f"Check the cell first. When the cause is removed, {ACKNOWLEDGE}."


class ProgramStopped(DeviceError):
    """Somebody stopped or paused our program, or started another one."""

    code = "URD-036"
    action = f"Check who did it at the pendant, then {ACKNOWLEDGE}."


SCRIPT_STOPPED = ErrorCode(
    "URD-037",
    LinkTimeout,
    "Our script stopped the arm by itself: no set-point came in time, or one was too far away.",
    (
        "Find what delayed the set-points: a busy computer (option starve_limit_s can allow more; start a "
        f"rehearsal with --lock-step), or the network. Then {ACKNOWLEDGE}."
    ),
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
    (
        "Check which arm answers at the endpoints. Plans and calibrations hold for the first one only: end "
        "this run, and connect anew."
    ),
)


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
    clock_name="timestamp",
    message_name="package",
    speed_name="the speed slider",
    speed_action=SPEED_AT_ZERO.action,
)
