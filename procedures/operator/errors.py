"""Errors raised by questions, checkpoints and guards."""

from __future__ import annotations

from ronna_hw.errors import EXIT_ABORTED, RefusedError, RonnaError


class NotConfirmed(RonnaError):
    """The operator answered no, or did not answer in time, which counts as no."""

    code = "PRO-002"
    action = (
        "Nothing was done. Repeat the step when the operator can confirm. Where a file of answers said no, "
        "change its line and resume with --answers FILE; a program without a terminal needs --console or "
        "--answers."
    )
    exit_code = EXIT_ABORTED


class OperatorAborted(RonnaError):
    """The operator ended the procedure."""

    code = "PRO-004"
    action = "Go on with this run by ronna-procedure resume RUN, or start a new one."
    exit_code = EXIT_ABORTED


class GuardUnmet(RefusedError):
    """A guard suspended the running step, and its condition was not restored."""

    code = "PRO-017"
    action = "Restore the condition it names, then repeat the step."
