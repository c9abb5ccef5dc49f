"""Export errors, EXC-001 to EXC-006."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError


class UnknownForm(ConfigurationError):
    """The file name extension matches no exchange format."""

    code = "EXC-001"
    action = "Use a name that ends in .dcm, .json, .mrk.json or .csv."


class NotWritable(DataError):
    """An exported file cannot be written."""

    code = "EXC-002"
    action = "Give another folder."


class NothingToExport(DataError):
    """The run has no result of the requested kind."""

    code = "EXC-003"
    action = "Give a case, such as runs/<run id>; figures of a calibration are in its report and result.json."


class FieldNotAllowed(DataError):
    """An object for export has an attribute that is not on the allow-list."""

    code = "EXC-004"
    action = "This is a fault of the program: nothing of that object was written."


class NoRegistration(DataError):
    """The run has no registration for the requested target."""

    code = "EXC-005"
    action = "Give a trajectory whose predicted_mm in run.targets is a number."


class NoSuchLook(DataError, IndexError):
    """The run has fewer looks of the stereo head."""

    code = "EXC-006"
    action = "len(run.pictures) counts them; the row of a look in run.looks is its place."
