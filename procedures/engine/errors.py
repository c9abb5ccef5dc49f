"""What the engine itself can refuse or lose."""

from __future__ import annotations

from ronna_hw.errors import (
    EXIT_ABORTED,
    EXIT_FAILED,
    EXIT_RECOVERY_NEEDED,
    EXIT_USAGE,
    DataError,
    RefusedError,
    RonnaError,
)


class StepRefused(RefusedError):
    """A step may not begin: the listed preconditions are not met."""

    code = "PRO-001"
    action = "Meet the listed preconditions, or run the steps that come before."


class NotConfirmed(RonnaError):
    """The operator said no, or did not answer in time, which counts as no."""

    code = "PRO-002"
    action = "Nothing was done. Repeat the step when the operator can confirm."
    exit_code = EXIT_ABORTED


class JournalNotWritable(RonnaError):
    """The journal cannot be written: without a journal nothing moves."""

    code = "PRO-003"
    action = "Free space or choose another output folder; the arm has been stopped."


class OperatorAborted(RonnaError):
    """The operator ended the procedure."""

    code = "PRO-004"
    action = "The arm is at rest. Start a new run when ready."
    exit_code = EXIT_ABORTED


class UnknownStep(RonnaError):
    """There is no step of that name in this procedure."""

    code = "PRO-005"
    action = "List the steps and use one of their names."
    exit_code = EXIT_USAGE


class GateFailed(RefusedError):
    """A result is outside the limits that it must meet before the procedure goes on."""

    code = "PRO-007"
    action = "Look at the value and its limit; repeat the step or correct its inputs."


class ToolUnchecked(RefusedError):
    """The mounted tool may have been taken off, exchanged or hit since it was checked."""

    code = "PRO-027"
    action = "It is checked again before it goes to a target."


class CommandRefused(RonnaError):
    """A command that this run started ended by itself; its last output is in the message."""

    code = "PRO-013"
    action = "Start again when that is put right."

    def __init__(self, name: str, messages: str, exit_code: int) -> None:
        super().__init__(f"{name} failed: {' '.join(messages.split()).rstrip('.')}")
        self.exit_code = exit_code if exit_code > 0 else EXIT_FAILED  # type: ignore[misc]


class WrongResult(RonnaError):
    """A step produced or requested a result that it does not declare."""

    code = "PRO-016"
    action = "Correct the step: its declaration names its result and the results it reads."


class GuardUnmet(RefusedError):
    """A guard suspended the running step, and what it watches was not restored."""

    code = "PRO-017"
    action = "Restore what it names, then repeat the step."


class EventsUnreadable(RonnaError):
    """A run's file of events holds something else, or another version wrote it."""

    code = "PRO-018"
    action = "Follow it with the version that runs it; its evidence is the journal, not this file."


class NotRecorded(DataError):
    """A replay needs something that the run has not kept."""

    code = "PRO-024"
    action = "This part of the run cannot be computed again; its records stand as they are."


class ReplayDiffers(RonnaError):
    """Results computed again are not those that were recorded."""

    code = "PRO-025"
    action = "Compare the versions, and check the run for edited files, before you rely on it."


class AnswersUnfit(RonnaError):
    """A file of answers does not fit the questions of the case."""

    code = "PRO-026"
    action = "Correct the file; topics and their words are in docs/reference/answers.md."
    exit_code = EXIT_USAGE


class RunInUse(RefusedError):
    """Another program has this run open: one operator at a time."""

    code = "PRO-030"
    action = "Operate it where it runs, or follow it with ronna-procedure watch."


class OtherProgram(RonnaError):
    """A run was made by another version of this program, which may have meant something else."""

    code = "PRO-031"
    action = "Resume it with the version that made it, or start a new run."
    exit_code = EXIT_RECOVERY_NEEDED


class RecoveryRefused(RonnaError):
    """A run is not taken up again: what was found differs from what was recorded, or was not accepted."""

    code = "PRO-032"
    action = "Restore what it names and resume again, or start a new run. Nothing was moved."
    exit_code = EXIT_RECOVERY_NEEDED


class BadRequestFile(RonnaError):
    """A folder is not that of a run, or the file that says what was asked for was changed."""

    code = "PRO-034"
    action = "Give the folder of a run, which begins with request.json."
    exit_code = EXIT_USAGE


class ConsoleMissing(RonnaError):
    """The browser console is not installed."""

    code = "PRO-040"
    action = "Install ronna-hw[console], or run without --console."
    exit_code = EXIT_USAGE
