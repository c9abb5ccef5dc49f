"""Errors of the exchange of results."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError


class UnknownForm(ConfigurationError):
    """No form of exchange has this file ending."""

    code = "EXC-001"
    action = "End the name with .dcm, .json, .mrk.json or .csv."


class NotWritable(DataError):
    """A file of the exchange cannot be written."""

    code = "EXC-002"
    action = "Give another folder."


class NothingToExport(DataError):
    """The run holds no result of the kind that was asked for."""

    code = "EXC-003"
    action = "Give the folder of a run that reached a registration, such as runs/<run id>."
