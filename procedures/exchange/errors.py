"""Errors of exported files, EXC-001 to EXC-006, and of markups, MRK-001 to MRK-003."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError, ErrorCode

UNKNOWN_FORM = ErrorCode(
    "EXC-001",
    ConfigurationError,
    "The file name extension matches no exchange format.",
    "Use a name that ends in .dcm, .json, .mrk.json or .csv.",
)

NOT_WRITABLE = ErrorCode("EXC-002", DataError, "An exported file cannot be written.", "Give another folder.")

NOTHING_TO_EXPORT = ErrorCode(
    "EXC-003",
    DataError,
    "The run has no result of the requested kind.",
    "Give a case, such as runs/<run id>; figures of a calibration are in its report and result.json.",
)

FIELD_NOT_ALLOWED = ErrorCode(
    "EXC-004",
    DataError,
    "An object for export has an attribute that is not on the allow-list.",
    "This is a fault of the program: nothing of that object was written.",
)

NO_REGISTRATION = ErrorCode(
    "EXC-005",
    DataError,
    "The run has no registration for the requested target.",
    "Give a trajectory whose predicted_mm in run.targets is a number.",
)


class NoSuchLook(DataError, IndexError):
    """The run has fewer looks of the stereo head."""

    code = "EXC-006"
    action = "len(run.pictures) counts them; the row of a look in run.looks is its place."


MARKUP_UNREADABLE = ErrorCode(
    "MRK-001",
    DataError,
    "A markups file is unreadable, or a markup is not a line of two placed points.",
    "In 3D Slicer draw each trajectory as a line with both ends placed, and save it as .mrk.json.",
)

MARKUP_OF_ANOTHER_FRAME = ErrorCode(
    "MRK-002",
    DataError,
    "A markup is in another frame of reference, coordinate system or unit.",
    "Draw it on the CT of the plan and save it in LPS or RAS, in millimetres.",
)

MARKUP_ENDS = ErrorCode(
    "MRK-003",
    DataError,
    "It is not known which end of a line is the target.",
    "Label the points with the words entry and target, or give --order entry-first or target-first.",
)
