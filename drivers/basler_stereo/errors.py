"""What can go wrong with the cameras."""

from __future__ import annotations

from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DeviceError,
    LimitError,
    LinkTimeout,
    ProtocolError,
)


class NoCamera(ConnectError):
    """Nothing answers a discovery at the address."""

    code = "GEV-001"
    action = "Check power, cable and the address in the theatre file; a camera and its host share one subnet."


class WrongModel(ConnectError):
    """A GigE Vision device answers, but another model than the theatre file awaits."""

    code = "GEV-002"
    action = "Check the address; if the model is meant, set expected_model in the options."


class WrongSerial(ConnectError):
    """A camera of the right model answers, but not the one that was calibrated on this side."""

    code = "GEV-003"
    action = "Check which camera is mounted; after a change of camera calibrate the head and edit the file."


class CablesSwapped(ConnectError):
    """The left camera answers at the right address and the other way round."""

    code = "GEV-004"
    action = "Swap the cables or the two endpoints in the theatre file."


class ControlTaken(ConnectError):
    """Another application controls the camera."""

    code = "GEV-005"
    action = "Close the other application. One that crashed is waited for; if it was slow, allow more time."


class CommandRefused(DeviceError):
    """The camera answered a command with a status that is not success."""

    code = "GEV-006"
    action = "See the status; if it repeats, close and connect again."
    status: int = 0  # as on the wire


class NoReply(LinkTimeout):
    """The camera did not answer a command in time, repetitions included."""

    code = "GEV-007"
    action = "Check power and cable of that camera and ask again; a fault is latched when it stays silent."


class MalformedReply(ProtocolError):
    """An answer does not have the form that the command asks for."""

    code = "GEV-008"
    action = "Check that a GigE Vision camera is at this address; note its firmware and report it."


class BadDescription(ProtocolError):
    """The camera's own description of its features cannot be read or does not make sense."""

    code = "GEV-009"
    action = "Note the camera's firmware version and report it; another firmware may help."


class MissingFeature(DeviceError):
    """The camera has no such feature, or cannot set it to this value."""

    code = "GEV-010"
    action = "Check the model and its firmware; this driver needs an area scan camera with software trigger."


class OutOfRange(LimitError):
    """An area, exposure or gain is outside what the camera allows."""

    code = "GEV-011"
    action = "Choose a value within the limit; areas also have a step."


class PacketTooLarge(ConfigurationError):
    """Packets of the chosen size do not arrive here."""

    code = "GEV-012"
    action = "Allow jumbo frames on the network card and every switch, or choose a smaller packet_bytes."


class TriggerMissed(LinkTimeout):
    """Both cameras took the trigger command, and no image came from either."""

    code = "GEV-013"
    action = "Check that no firewall drops UDP from the cameras and that the exposure fits the time limit."


class CameraLost(LinkTimeout):
    """A camera that was there no longer answers."""

    code = "GEV-014"
    action = "Check power and cable of that camera, then recover."


class ControlLost(DeviceError):
    """The camera no longer takes us for its controller: it restarted, or our heartbeat came too late."""

    code = "GEV-015"
    action = "Find out what stalled or restarted, then recover; the settings are written anew."


class BadOptions(ConfigurationError):
    """The options of the stereo pair in the theatre file have mistakes; all of them are listed."""

    code = "GEV-016"
    action = "Correct the options; the reference lists every key."


class ReceiverEnded(DeviceError):
    """The driver's own process that receives the images has ended."""

    code = "GEV-017"
    action = "Recover; the process is started anew. If it ends again, look for what ends it (memory, limits)."


class NoPylon(ConfigurationError):
    """The vendor's library that this driver stands on is not installed."""

    code = "GEV-018"
    action = "Install the optional extra: pip install 'ronna-hw[pylon]'; or use the driver basler_stereo."
