"""Export errors, EXC-001 to EXC-009, and those of markups, MRK-001 to MRK-003."""

from __future__ import annotations

from ronna_hw.errors import EXIT_USAGE, ConfigurationError, DataError, ErrorCode, RonnaError

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
    """The run has fewer image pairs of the stereo head."""

    code = "EXC-006"
    action = "len(run.pictures) counts them; the row of a pair in run.looks is its place."


OTHER_CT = ErrorCode(
    "EXC-007",
    DataError,
    "The CT of which patient and study were to be copied is not the one that the result was made from.",
    "Give the folder of the run's own CT series: its UID is the series_instance_uid in export.json.",
)

CT_OF_NO_PATIENT = ErrorCode(
    "EXC-008",
    DataError,
    "The CT does not name exactly one patient and one study, so no archive could file the objects.",
    "Export the series again from the archive, with its patient; or export without an identity.",
)

REPORT_PACKAGE_MISSING = ErrorCode(
    "EXC-009",
    RonnaError,
    "The package for DICOM structured reports is not installed.",
    "Run make setup in the clone, or in its environment: pip install 'ronna-hw[dicom]'.",
    own_exit_code=EXIT_USAGE,
)

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
