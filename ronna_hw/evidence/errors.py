"""Errors in the evidence of a run."""

from __future__ import annotations

from ronna_hw.errors import RefusedError, RonnaError


class JournalCorrupt(RonnaError):
    """A journal's chain is broken: a line was changed, lost or torn in the middle."""

    code = "PRO-011"
    action = "Do not rely on this run; keep the folder as it is for analysis."


class RunChanged(RefusedError):
    """The files of a run were changed after the run."""

    code = "PRO-033"
    action = "Do not rely on this run; keep the folder as it is. ronna-procedure verify RUN lists everything."
