"""What the journal refuses."""

from __future__ import annotations

from ronna_hw.errors import RonnaError


class JournalNotWritable(RonnaError):
    """The journal cannot be written; without a journal nothing moves."""

    code = "PRO-003"
    action = "Free space or choose another output folder; the arm has been stopped."
