"""Errors raised by the engine."""

from __future__ import annotations

from ronna_hw.errors import (
    EXIT_FAILED,
    EXIT_RECOVERY_NEEDED,
    EXIT_USAGE,
    DataError,
    RefusedError,
    RonnaError,
)
from ronna_hw.host.process import describe_exit


class UnknownStep(RonnaError):
    """This procedure has no step of that name."""

    code = "PRO-005"
    action = "List the steps and use one of their names."
    exit_code = EXIT_USAGE


class ToolUnchecked(RefusedError):
    """The mounted tool may have been removed, exchanged or hit since its check."""

    code = "PRO-027"
    action = "It is checked again before it goes to a target."


class CommandRefused(RonnaError):
    """A program started by this run failed; the message contains its last output."""

    code = "PRO-013"
    action = "Correct that, then start again."

    def __init__(self, name: str, messages: str, exit_code: int) -> None:
        words = messages.split() if exit_code >= 0 else [describe_exit(exit_code), *messages.split()]
        super().__init__(f"{name} failed: {' '.join(words).rstrip('.')}")
        self.exit_code = exit_code if exit_code > 0 else EXIT_FAILED


class WrongResult(RonnaError):
    """A step produced or requested a result that it does not declare."""

    code = "PRO-016"
    action = "Correct the step: its declaration names its result and the results it reads."


class EventsUnreadable(RonnaError):
    """A run's event file is invalid or was written by another version."""

    code = "PRO-018"
    action = "Follow the run with the version that runs it; the journal, not this file, is the evidence."


class NotRecorded(DataError):
    """A replay needs data that the run did not record."""

    code = "PRO-024"
    action = "This part of the run cannot be recomputed; its records remain valid."


class ReplayDiffers(RonnaError):
    """Recomputed results differ from the recorded ones."""

    code = "PRO-025"
    action = "Compare the program versions and check the run for edited files before relying on it."


class AnswersUnfit(RonnaError):
    """An answers file does not match the questions of the case."""

    code = "PRO-026"
    action = "Correct the file; docs/reference/answers.md lists the topics and their answers."
    exit_code = EXIT_USAGE


class RunInUse(RefusedError):
    """The run is already open in another program; only one may operate it at a time."""

    code = "PRO-030"
    action = "Operate it where it runs, or follow it with ronna-procedure watch."


class OtherProgram(RonnaError):
    """The run was made by another program version, so its records may have a different meaning."""

    code = "PRO-031"
    action = "Resume it with the version that made it, or start a new run."
    exit_code = EXIT_RECOVERY_NEEDED


class RecoveryRefused(RonnaError):
    """The run was not resumed: the findings differ from its records, or were not accepted."""

    code = "PRO-032"
    action = "Nothing was moved. Put right what is named, then repeat the command."
    exit_code = EXIT_RECOVERY_NEEDED


class BadRequestFile(RonnaError):
    """The folder is not a run folder, or its request file was changed."""

    code = "PRO-034"
    action = "Give a run folder, which contains request.json."
    exit_code = EXIT_USAGE


class ConsoleMissing(RonnaError):
    """The browser console is not installed."""

    code = "PRO-040"
    action = "Install ronna-hw[console], or run without --console."
    exit_code = EXIT_USAGE


class FaultOfRun(RefusedError):
    """The fault belongs to an unfinished run and must be acknowledged there."""

    code = "PRO-044"
    action = "Acknowledge it in that run."


class InstrumentLeftInside(RefusedError):
    """An earlier run on this theatre left, or may have left, an instrument inside."""

    code = "PRO-047"
    action = "Touch neither the tool nor the arm: bring that run's arm home first."


class CaseLeftWithInstrument(RonnaError):
    """The commands of a case ended while an instrument was, or may have been, inside."""

    code = "PRO-055"
    action = "Move nothing by hand. Bring the arm home with the run: it asks for the removal first."
    exit_code = EXIT_RECOVERY_NEEDED


class TheatreNotNoted(RefusedError):
    """The file that records which run last moved the arm cannot be written."""

    code = "PRO-045"
    action = "Make that file writable for a group of everyone who uses this arm (chgrp, chmod g+w)."


class HistoryChanged(RefusedError):
    """A line of a theatre file's history is not as it was written."""

    code = "PRO-046"
    action = "Put the history back from a backup, or move it away: it then begins with the file as it is."


class TheatreInUse(RefusedError):
    """The devices of the theatre are in use by another program."""

    code = "PRO-043"
    action = "Wait until it has ended; its arm may be at a patient."
