"""Errors of the stereo cameras, GEV-001 to GEV-018."""

from __future__ import annotations

from ronna_hw.devices.errors import ACKNOWLEDGE
from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DeviceError,
    ErrorCode,
    LimitError,
    LinkTimeout,
    ProtocolError,
)


class NoCamera(ConnectError):
    """No camera replied to discovery at this address."""

    code = "GEV-001"
    action = "Check power, cable and the address in the theatre file; camera and host must share a subnet."


WRONG_MODEL = ErrorCode(
    "GEV-002",
    ConnectError,
    "The device found is not the camera model that the theatre file expects.",
    "Check the address; if this model is intended, set expected_model in the options.",
)


WRONG_SERIAL = ErrorCode(
    "GEV-003",
    ConnectError,
    "The camera is not the one calibrated for this side.",
    "Check which camera is mounted and its serial number in the options; after replacing a camera, "
    "calibrate the head and edit the file.",
)


CABLES_SWAPPED = ErrorCode(
    "GEV-004",
    ConnectError,
    "The left camera is at the right camera's address and vice versa.",
    "Swap the cables or the two endpoints in the theatre file.",
)


class ControlTaken(ConnectError):
    """Another application controls the camera."""

    code = "GEV-005"
    action = "Close the other application. After a crash its control lapses by itself; allow more time."


class CommandRefused(DeviceError):
    """The camera rejected a command with an error status."""

    code = "GEV-006"
    action = "Look up the status; if it recurs, close and reconnect."
    status: int = 0  # as on the wire


class NoReply(LinkTimeout):
    """The camera did not acknowledge a command in time, despite retries."""

    code = "GEV-007"
    action = "Check power and cable of that camera and try again; if it stays silent, a fault is latched."


class MalformedReply(ProtocolError):
    """The camera's reply to a command is malformed."""

    code = "GEV-008"
    action = "Check that a GigE Vision camera is at this address; note its firmware and report it."


BAD_DESCRIPTION = ErrorCode(
    "GEV-009",
    ProtocolError,
    "The camera's GenICam description cannot be read or is inconsistent.",
    "Note the camera's firmware version and report it; another firmware may help.",
)


MISSING_FEATURE = ErrorCode(
    "GEV-010",
    DeviceError,
    "The camera lacks a feature, or the feature does not support the requested value.",
    "Check the model and its firmware; this driver needs an area scan camera with software trigger.",
)


OUT_OF_RANGE = ErrorCode(
    "GEV-011",
    LimitError,
    "An area, exposure or gain is outside the camera's limits.",
    "Choose a value within the limits; areas also have a step size.",
)


PACKET_TOO_LARGE = ErrorCode(
    "GEV-012",
    ConfigurationError,
    "Stream packets of the configured size do not reach this computer.",
    "Allow jumbo frames on the network card and every switch, or choose a smaller packet_bytes.",
)


class TriggerMissed(LinkTimeout):
    """Both cameras acknowledged the trigger, but neither sent an image."""

    code = "GEV-013"
    action = (
        "Check that no firewall drops UDP from the cameras, that the exposure fits the time limit, and that "
        "nothing else loads this computer."
    )


class CameraLost(LinkTimeout):
    """A connected camera no longer replies."""

    code = "GEV-014"
    action = f"Check power and cable of that camera, then {ACKNOWLEDGE}."


class ControlLost(DeviceError):
    """Control of a camera was lost, because it restarted or the heartbeat was too late."""

    code = "GEV-015"
    action = f"Find out what stalled or restarted, then {ACKNOWLEDGE}. All settings are written again."


BAD_OPTIONS = ErrorCode(
    "GEV-016",
    ConfigurationError,
    "The stereo options in the theatre file contain mistakes.",
    "Correct the options; docs/reference/stereo-options.md lists every key.",
)


class ReceiverEnded(DeviceError):
    """The driver's receiver process has ended."""

    code = "GEV-017"
    action = (
        f"To restart it, {ACKNOWLEDGE}. If it ends again, find out what kills it (memory, resource limits)."
    )


NO_PROJECTOR = ErrorCode(
    "GEV-019",
    ConfigurationError,
    "The line projector was switched, but the theatre file names none.",
    "Give the camera and its output line in [stereo.options.projector], or use a head with a projector.",
)


NO_OUTPUT_LINE = ErrorCode(
    "GEV-020",
    ConfigurationError,
    "The camera has no such output line, or the line cannot have that source.",
    "Correct line and source in [stereo.options.projector]; Basler calls the opto-isolated output Out1.",
)


OUTPUT_STUCK = ErrorCode(
    "GEV-021",
    DeviceError,
    "The output line of the projector does not follow its setting.",
    "Switch the projector off at its key. Check its wiring, then `inverted` in [stereo.options.projector].",
)


NO_PYLON = ErrorCode(
    "GEV-018",
    ConfigurationError,
    "The vendor library pypylon is not installed.",
    "Install the optional extra: pip install 'ronna-hw[pylon]'; or use the driver basler_stereo.",
)
