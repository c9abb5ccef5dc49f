"""Errors of the connection to a Universal Robots controller."""

from __future__ import annotations

from ronna_hw.arm_stream.errors import StreamErrors
from ronna_hw.devices.errors import ACKNOWLEDGE, MotionInterrupted
from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DataError,
    DeviceError,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
    StateError,
)


class BadOptions(ConfigurationError):
    """The arm options in the theatre file are invalid."""

    code = "URD-001"
    action = "Correct the listed options; docs/reference/ur-options.md describes them."


class ControllerNotFound(ConnectError):
    """No Universal Robots controller answers at an endpoint."""

    code = "URD-002"
    action = (
        "Check the address and the cable, that the controller has started, and that Settings > Security "
        "allows its services dashboard, primary client and RTDE."
    )


class WrongArm(ConnectError):
    """The arm at the endpoint has another model or serial number than the theatre file states."""

    code = "URD-003"
    action = "Correct the endpoints, or the options model and serial."


class WrongVersion(ConnectError):
    """The controller's software lacks what the driver needs."""

    code = "URD-004"
    action = "Update the controller: PolyScope 3.9 or newer on CB3, 5.6 or newer on the e-Series."


class FactoryCalibrationDiffers(ConnectError):
    """The controller's factory calibration is not the one that this theatre was measured with."""

    code = "URD-005"
    action = (
        "Check that this is the arm of this theatre. If it has been exchanged or calibrated anew, repeat the "
        "calibrations of the theatre, then correct option calibration."
    )


class LocalMode(RefusedError):
    """The controller is not in remote control, so that it accepts no program."""

    code = "URD-006"
    action = "Choose remote control at the top right of the pendant's screen."


class EmergencyStopped(RefusedError):
    """An emergency stop is pressed."""

    code = "URD-007"
    action = "Release the emergency stop when the cell is safe, then start again."


class NotPowered(RefusedError):
    """The arm could not be switched on, or its brakes could not be released."""

    code = "URD-008"
    action = "Read the pendant's messages, and switch the arm on there (red button at the bottom left)."


class ProtectivelyStopped(RefusedError):
    """The controller has stopped the arm for its protection, and nobody has acknowledged it."""

    code = "URD-009"
    action = f"Find the cause at the arm first, and wait for 5 s. Then {ACKNOWLEDGE}."


class SafetyStopped(RefusedError):
    """A safeguard, or a fault of the controller's safety system, prevents motion."""

    code = "URD-010"
    action = f"Reset the safeguard; after a violation or fault read the pendant's messages and {ACKNOWLEDGE}."


class SpeedAtZero(RefusedError):
    """The speed slider is at zero: no motion would ever end."""

    code = "URD-011"
    action = "Raise the speed slider at the bottom of the pendant's screen."


class RegistersInUse(ConnectError):
    """Another client or a fieldbus owns the registers through which our script is driven."""

    code = "URD-012"
    action = "End the other client (another run, a fieldbus with these registers), then start again."


class AnotherProgramRuns(RefusedError):
    """The controller is running a program that this driver did not start."""

    code = "URD-013"
    action = "Check who started it, stop it at the pendant, then start again."


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


class ScriptNotStarted(DeviceError):
    """The controller did not start our script, or the script ended at once."""

    code = "URD-018"
    action = (
        "Read the pendant's log page. If it has no message, the script did not arrive: check that endpoint "
        "primary is of this controller, and that Settings > Security allows the primary client interface."
    )


class LinkNotStarted(ConnectError):
    """The real-time process did not start."""

    code = "URD-020"
    action = "Check the computer's memory and process limits, then start again."


class LinkSilent(LinkTimeout):
    """Packages stopped arriving while the stream was running."""

    code = "URD-021"
    action = f"The script stops the arm. Check the cable and the controller, then {ACKNOWLEDGE}."


class LinkBroken(ProtocolError):
    """The RTDE connection ended, or carried bytes that are no package, while the stream was running."""

    code = "URD-022"
    action = f"The script stops the arm. Check the cable and the controller, then {ACKNOWLEDGE}."


class HeartbeatLate(LinkTimeout):
    """This program's heartbeat to the real-time process was late, so the arm was stopped."""

    code = "URD-023"
    action = f"Reduce the computer's load, or find what blocked the program; then {ACKNOWLEDGE}."


class LinkProcessDied(DeviceError):
    """The real-time process terminated unexpectedly."""

    code = "URD-024"
    action = f"The script stops the arm. Then {ACKNOWLEDGE}. Report the message if it repeats."


class LinkProcessStalled(DeviceError):
    """The real-time process is running but stalled, so the controller gets no set-points."""

    code = "URD-025"
    action = (
        "The script stops the arm. Find what blocks the process or the computer; "
        f"then {ACKNOWLEDGE}. A new process is started."
    )


class MotionTripped(LimitError):
    """The monitor stopped the arm."""

    code = "URD-026"
    action = f"Read the recorded cycles, find the cause, then {ACKNOWLEDGE}."


class PathFailed(LimitError):
    """The path had no solution at some point, so the arm was stopped in joint space."""

    code = "URD-027"
    action = f"First {ACKNOWLEDGE}. Then move away from the singular pose by a joint move."


class LinkUnusable(LinkTimeout):
    """Too many set-points came late for too long, so the arm was stopped."""

    code = "URD-028"
    action = (
        f"Find what loads the computer or the network to the controller, which must carry nothing else; "
        f"then {ACKNOWLEDGE}."
    )


class ProtectiveStop(StateError):
    """A protective stop was requested; it remains latched."""

    code = "URD-029"
    action = f"Find the reason, then {ACKNOWLEDGE}."


class LinkStopped(StateError):
    """Set-points were withheld on request, so that the script stops the arm."""

    code = "URD-030"
    action = f"Find the reason, then {ACKNOWLEDGE}."


class DrivesOff(StateError):
    """The arm was switched off on request, and a fault is latched."""

    code = "URD-031"
    action = f"Find the reason, then {ACKNOWLEDGE}."


class MotionStopped(MotionInterrupted):
    """A motion was stopped before its end, with the arm at rest on its path."""

    code = "URD-032"
    action = "Resume and plan a new motion from here; an interrupted path is not continued."


class MotionNotFinished(LinkTimeout):
    """The motion did not end, or the arm did not settle, within the time limit."""

    code = "URD-033"
    action = "Check the speed slider and the lost cycles, or give the motion more time."


class MotionRefused(RefusedError):
    """The real-time process refused a motion."""

    code = "URD-034"
    action = "Wait for the current motion to end, and plan from the arm's current pose."


class ControllerStopped(LimitError):
    """Emergency stop, safeguard, protective stop, power or the control mode interrupted a running stream."""

    code = "URD-035"
    action = f"Check the cell first. When the cause is removed, {ACKNOWLEDGE}."


class ProgramStopped(DeviceError):
    """Somebody stopped or paused our program, or started another one."""

    code = "URD-036"
    action = f"Check who did it at the pendant, then {ACKNOWLEDGE}."


class ScriptStopped(LinkTimeout):
    """Our script stopped the arm by itself: no set-point came in time, or one was too far away."""

    code = "URD-037"
    action = (
        "Find what delayed the set-points: a busy computer (option starve_limit_s can allow more; start a "
        f"rehearsal with --lock-step), or the network. Then {ACKNOWLEDGE}."
    )


class ControllerRestarted(DeviceError):
    """The controller's time jumped: it is another run of the controller than at the start."""

    code = "URD-038"
    action = f"Check the controller, then {ACKNOWLEDGE}."


class PoseImplausible(DeviceError):
    """At the start the arm is outside its joint ranges, or not where it is commanded to be."""

    code = "URD-039"
    action = (
        f"Check that nothing touches the arm; bring it into its ranges at the pendant. Then {ACKNOWLEDGE}."
    )


class LoadNotTaken(RefusedError):
    """The controller does not use the mass, centre of gravity or tool centre point that were set."""

    code = "URD-040"
    action = "Read the pendant's messages, and set the payload again; without it the force is not known."


class BadLoad(DataError):
    """The load of a tool is not one that the arm can carry."""

    code = "URD-041"
    action = "Give the mass in kg, and places in mm in the frame of the flange."


class ControllerExchanged(ConnectError):
    """At a recovery another arm, software or factory calibration is found than was connected."""

    code = "URD-042"
    action = (
        "Check which arm answers at the endpoints. Plans and calibrations hold for the first one only: end "
        "this run, and connect anew."
    )


STREAM_ERRORS = StreamErrors(
    not_found=ControllerNotFound,
    lost=ControllerLost,
    no_answer=NoAnswer,
    not_started=LinkNotStarted,
    died=LinkProcessDied,
    stalled=LinkProcessStalled,
    silent=LinkSilent,
    heartbeat_late=HeartbeatLate,
    tripped=MotionTripped,
    path_failed=PathFailed,
    unusable=LinkUnusable,
    protective_stop=ProtectiveStop,
    link_stopped=LinkStopped,
    drives_off=DrivesOff,
    stopped=MotionStopped,
    not_finished=MotionNotFinished,
    refused=MotionRefused,
    clock_name="timestamp",
    message_name="package",
    speed_name="the speed slider",
    speed_action=SpeedAtZero.action,
)
