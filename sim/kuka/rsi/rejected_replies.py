"""Replies rejected by the controller, reported between cycles, rate-limited: a real one reports nothing."""

from __future__ import annotations

import re
from collections.abc import Callable

AGAIN_S = 1.0  # between two lines, at any rate of rejections

_TYPE = re.compile(rb"<Sen\b[^>]*\bType\s*=\s*[\"']([^\"'<>]{0,40})")
_IPOC = re.compile(rb"<IPOC>\s*(\d{1,20})\s*</IPOC>")


class RejectedReplies:
    """Counts rejected replies; `tell` passes on the last reason, at most once per `AGAIN_S`."""

    def __init__(self, sentype: str) -> None:
        self.count = 0
        self._sentype = sentype
        self._reported = 0
        self._reported_s = float("-inf")
        self._last: tuple[bytes, int] = (b"", 0)

    def note(self, data: bytes, ipoc: int) -> None:
        """Count one more, in the cycle with this time stamp; costs next to nothing."""
        self.count += 1
        self._last = (data, ipoc)

    def tell(self, now_s: float, say: Callable[[str, int], None]) -> None:
        """Report why the last one was rejected, and how many were, if new and due."""
        if self.count == self._reported or now_s < self._reported_s + AGAIN_S:
            return
        self._reported, self._reported_s = self.count, now_s
        say(f"reply rejected: {self._reason()}", self.count)

    def _reason(self) -> str:
        data, expected = self._last
        found = _TYPE.search(data)
        if found is None:
            return "no <Sen Type=...>"
        if found[1] != self._sentype.encode():
            return f"Type {found[1].decode('ascii', 'replace')}, expected {self._sentype}"
        stamp = _IPOC.search(data)
        if stamp is None:
            return "no IPOC"
        if int(stamp[1]) != expected:
            return f"IPOC {int(stamp[1])}, expected {expected}, that of the telegram it answers"
        return "not well-formed XML, or a value that is not a number"
