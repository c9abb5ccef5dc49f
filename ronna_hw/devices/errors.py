"""Device errors that are independent of the protocol."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError, ErrorCode, LinkTimeout, RefusedError, StateError

# What clears a latched fault, for everyone who may read the message: the operator of a held case or at the
# command line, and the author of a program.
ACKNOWLEDGE = (
    "acknowledge by name (nothing moves): in the held case, with ronna-procedure acknowledge RUN --by NAME, "
    "or in Python with recover(acknowledged_by)"
)


class WrongState(StateError):
    """A call is not allowed in the device's lifecycle state. After a latched fault its exit code is used."""

    code = "DEV-001"
    action = f"Bring the device to the expected state first; after a fault, {ACKNOWLEDGE}."


class MotionInterrupted(StateError):
    """A `stop` call from elsewhere ended a motion early; the arm is at rest on its path in HOLD.

    Each arm driver has its own subclass, with its code.
    """


UNKNOWN_DRIVER = ErrorCode(
    "DEV-002",
    ConfigurationError,
    "No installed package provides a driver of this name.",
    "Check the driver name in the theatre file, or install the package that provides it.",
)


class NotInTheatre(ConfigurationError, KeyError):
    """The theatre file lacks the requested device or table."""

    code = "DEV-007"
    action = "Add its table to the theatre file, with driver and endpoint, or request an existing one."

    __str__ = Exception.__str__  # a KeyError shows its message in quotes


WRONG_KIND = ErrorCode(
    "DEV-008",
    ConfigurationError,
    "The driver of a device does not provide the requested interface.",
    "Name a driver of that kind in the device's table, or request an interface that its driver provides.",
)


THEATRE_CLOSED = ErrorCode(
    "DEV-010",
    WrongState,
    "A theatre or one of its devices was used after it was closed.",
    "Use devices inside the block of open_theatre or simulated_theatre; once closed, open the theatre again.",
)


OTHER_PROCESS = ErrorCode(
    "DEV-016",
    WrongState,
    "A device was called in another process than the one that opened it, such as a fork.",
    "Call it where it was opened, and tell that process by a queue or an event; so with a stop.",
)


NO_NEW_FRAME = ErrorCode(
    "DEV-009",
    LinkTimeout,
    "The tracker replies, but delivers no new measurement within the time limit.",
    "Check that the tracker is tracking, and allow more than one frame period.",
)


STREAM_BEHIND = ErrorCode(
    "DEV-011",
    DataError,
    "Every reading of a device was asked for, and too many wait to be taken.",
    "Do less with each reading, or ask for the newest alone: every=False.",
)


STREAM_TAKEN = ErrorCode(
    "DEV-013",
    ConfigurationError,
    "A stream of readings was read by two at a time.",
    "Leave the first loop, or close its iterator; one consumer may pass readings on.",
)


DEVICE_STREAMS = ErrorCode(
    "DEV-014",
    WrongState,
    "A device was called while its stream, or another thread, reads it.",
    "Take readings from the stream, or leave its loop (close its iterator) and call again; of several "
    "threads, let one read, and pass on what it reads.",
)


CALL_GOES_ON = ErrorCode(
    "DEV-015",
    DataError,
    "A function that gets the readings of a stream had not done with them some time after its block.",
    "Do less with each reading, or allow more time: calling(function, end_limit_s=60.0).",
)


NO_NEW_STATE = ErrorCode(
    "DEV-012",
    LinkTimeout,
    "The arm answers, but its stream delivers no new state within the time limit.",
    "Check that its program runs and the link has cycles: ronna-procedure doctor --config FILE.",
)


class UnknownTool(ConfigurationError, LookupError):
    """The tracker has no tool with this name."""

    code = "DEV-003"
    action = "Use the name of a tool in the tracker's options, or add the tool there."


NO_POSE = ErrorCode(
    "DEV-004",
    DataError,
    "A reading has no pose, or its pose cannot be trusted.",
    "Check the validity of the reading before using its pose.",
)


BAD_STRAYS = ErrorCode(
    "DEV-005",
    DataError,
    "The strays are not valid positions, or a grouping parameter is out of range.",
    "Pass positions of three finite numbers in mm, a positive radius and a share between 0 and 1.",
)


class PersonNotNamed(RefusedError, ValueError):
    """A fault was acknowledged or a hazard confirmed without a person's name."""

    code = "DEV-006"
    action = "Give the name of the person who takes responsibility; on a command line: --by NAME."
