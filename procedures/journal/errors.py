"""Journal and result errors."""

from __future__ import annotations

from ronna_hw.errors import RefusedError, RonnaError


class JournalNotWritable(RonnaError):
    """The journal cannot be written. Nothing may move without a journal."""

    code = "PRO-003"
    action = (
        "Free space, raise a limit of ulimit -f, or choose another output folder; the arm has been stopped."
    )


class RunDeleted(JournalNotWritable):
    """The folder of a run, or its journal, was deleted while the run was open."""

    code = "PRO-053"
    action = (
        "Nothing may move without a journal. What was deleted cannot be resumed: start a new run once the "
        "arm is at home."
    )


class StepRefused(RefusedError):
    """A step cannot start because its preconditions, listed in the message, are not met."""

    code = "PRO-001"
    action = "Do what is listed, or run the earlier steps first."


class GateFailed(RefusedError):
    """A result is outside the limits required for the procedure to continue."""

    code = "PRO-007"
    action = "Compare the value with its limit; repeat the step or correct its inputs."
