"""Errors raised by the engine."""

from __future__ import annotations

from ronna_hw.errors import (
    EXIT_FAILED,
    EXIT_RECOVERY_NEEDED,
    EXIT_USAGE,
    DataError,
    ErrorCode,
    RefusedError,
    RonnaError,
)
from ronna_hw.host.process import describe_exit


class UnknownStep(RonnaError):
    """This procedure has no step of that name."""

    code = "PRO-005"
    action = "List the steps and use one of their names."
    exit_code = EXIT_USAGE


TOOL_UNCHECKED = ErrorCode(
    "PRO-027",
    RefusedError,
    "The mounted tool may have been removed, exchanged or hit since its check.",
    "It is checked again before it goes to a target.",
)


class CommandRefused(RonnaError):
    """A program started by this run failed; the message contains its last output."""

    code = "PRO-013"
    action = "Correct that, then start again."

    def __init__(self, name: str, messages: str, exit_code: int) -> None:
        words = messages.split() if exit_code >= 0 else [describe_exit(exit_code), *messages.split()]
        super().__init__(f"{name} failed: {' '.join(words).rstrip('.')}")
        self.exit_code = exit_code if exit_code > 0 else EXIT_FAILED


WRONG_RESULT = ErrorCode(
    "PRO-016",
    RonnaError,
    "A step produced or requested a result that it does not declare.",
    "Correct the step: its declaration names its result and the results it reads.",
)


EVENTS_UNREADABLE = ErrorCode(
    "PRO-018",
    RonnaError,
    "A run's event file is invalid or was written by another version.",
    "Follow the run with the version that runs it; the journal, not this file, is the evidence.",
)


class NotRecorded(DataError):
    """A replay needs data that the run did not record."""

    code = "PRO-024"
    action = "This part of the run cannot be recomputed; its records remain valid."


class ReadingsChanged(NotRecorded):
    """Readings that a replay needs are not as the run recorded them."""

    action = "The file was changed after the run: ronna-procedure verify lists what was."


REPLAY_DIFFERS = ErrorCode(
    "PRO-025",
    RonnaError,
    "Recomputed results differ from the recorded ones.",
    "Compare the program versions and check the run for edited files before relying on it.",
)


ANSWERS_UNFIT = ErrorCode(
    "PRO-026",
    RonnaError,
    "An answers file does not match the questions of the case.",
    "Correct the file; docs/reference/answers.md lists the topics and their answers.",
    own_exit_code=EXIT_USAGE,
)


RUN_IN_USE = ErrorCode(
    "PRO-030",
    RefusedError,
    "The run is already open in another program; only one may operate it at a time.",
    "Operate it where it runs, or follow it with ronna-procedure watch.",
)


OTHER_PROGRAM = ErrorCode(
    "PRO-031",
    RonnaError,
    "The run was made by another program version, so its records may have a different meaning.",
    "Resume it with the version that made it, or start a new run.",
    own_exit_code=EXIT_RECOVERY_NEEDED,
)


RECOVERY_REFUSED = ErrorCode(
    "PRO-032",
    RonnaError,
    "The run was not resumed: the findings differ from its records, or were not accepted.",
    "Nothing was moved. Put right what is named, then repeat the command.",
    own_exit_code=EXIT_RECOVERY_NEEDED,
)


BAD_REQUEST_FILE = ErrorCode(
    "PRO-034",
    RonnaError,
    "The folder is not a run folder, or its request file was changed.",
    "Give a run folder, which contains request.json.",
    own_exit_code=EXIT_USAGE,
)


CONSOLE_MISSING = ErrorCode(
    "PRO-040",
    RonnaError,
    "The browser console is not installed.",
    "Run make setup in the clone, or in its environment: pip install 'ronna-hw[console]'. "
    "Or run without --console.",
    own_exit_code=EXIT_USAGE,
)


FAULT_OF_RUN = ErrorCode(
    "PRO-044",
    RefusedError,
    "The fault belongs to an unfinished run and must be acknowledged there.",
    "Acknowledge it in that run.",
)


class InstrumentLeftInside(RefusedError):
    """An earlier run on this theatre left, or may have left, an instrument inside."""

    code = "PRO-047"
    action = "Touch neither the tool nor the arm: bring that run's arm home first."


CASE_LEFT_WITH_INSTRUMENT = ErrorCode(
    "PRO-055",
    RonnaError,
    "The commands of a case ended while an instrument was, or may have been, inside.",
    "Move nothing by hand. Bring the arm home with the run: it asks for the removal first.",
    own_exit_code=EXIT_RECOVERY_NEEDED,
)


class TheatreNotNoted(RefusedError):
    """The file that records which run last moved the arm cannot be written."""

    code = "PRO-045"
    action = "Make that file writable for a group of everyone who uses this arm (chgrp, chmod g+w)."


HISTORY_CHANGED = ErrorCode(
    "PRO-046",
    RefusedError,
    "A line of a theatre file's history is not as it was written.",
    "Put the history back from a backup, or move it away: it then begins with the file as it is.",
)


class TheatreInUse(RefusedError):
    """The devices of the theatre are in use by another program."""

    code = "PRO-043"
    action = "Wait until it has ended; its arm may be at a patient."
