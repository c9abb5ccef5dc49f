"""The operator's seat at the console: one lease, taken by a name, kept by renewing it."""

from __future__ import annotations

import time
from collections.abc import Callable

LEASE_S = 10.0  # host time without a sign of life; a page renews each second


class Seat:
    """Who operates. Not safe for threads by itself."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        """`now_s` is the host's time."""
        self._now_s = now_s
        self._session = self._name = ""
        self._renewed_s = 0.0
        self.ever_taken = False

    @property
    def holder(self) -> str:
        """The name in which the seat is held; empty when it is free, also when its lease has run out."""
        return self._name if self._now_s() - self._renewed_s <= LEASE_S else ""

    @property
    def lapsed(self) -> bool:
        """Whether someone was in it and has not renewed."""
        return bool(self._name) and not self.holder

    def claim(self, session: str, name: str) -> str:
        """Take it; returns why that is refused, or nothing."""
        if self.holder and session != self._session:
            return f"the seat is taken by {self.holder}"
        self._session, self._name, self._renewed_s = session, name, self._now_s()
        self.ever_taken = True
        return ""

    def held_by(self, session: str) -> bool:
        """Whether that session is the operator's."""
        return bool(self.holder) and session == self._session

    def renew(self, session: str) -> None:
        """A sign of life; of another session, or too late, it changes nothing."""
        if self.held_by(session):
            self._renewed_s = self._now_s()

    def free(self) -> None:
        """Nobody is in it any more."""
        self._session = self._name = ""
