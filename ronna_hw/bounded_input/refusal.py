"""The common refusal of everything out of bounds."""

from __future__ import annotations

from ronna_hw.errors import DataError


class InputRefused(DataError):
    """A file or a message from outside is larger, deeper or denser than anything legitimate."""

    code = "INP-001"
    action = "Find out where it comes from; files written by these programs are far below the limit."
