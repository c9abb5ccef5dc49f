"""Who may view and who may operate: two tokens of a run, each exchanged once per browser for a session."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from enum import StrEnum

TOKEN_BYTES = 32
MOST_SESSIONS = 64  # per role; the oldest is dropped for a new one
ORDERS_PER_SECOND = 10
PAGES, PAGES_S = 8, 4.0  # of a role in so many seconds: making one holds up everything else for tens of ms


class Rate:
    """At most so many in any span of time."""

    def __init__(self, count: int, span_s: float) -> None:
        self._span_s = span_s
        self._counted_s: deque[float] = deque(maxlen=count)

    def allows(self, now_s: float) -> bool:
        """Whether there have not been too many; counts this one if so."""
        full = len(self._counted_s) == self._counted_s.maxlen
        if full and now_s - self._counted_s[0] < self._span_s:
            return False
        self._counted_s.append(now_s)
        return True


class Role(StrEnum):
    """What a session may do."""

    OPERATOR = "operator"
    VIEWER = "viewer"


@dataclass
class Session:
    """One browser. `identifier` may be shown and recorded; the content of its cookie may not."""

    role: Role
    identifier: str
    orders: Rate = field(default_factory=lambda: Rate(ORDERS_PER_SECOND, 1.0))


class Sessions:
    """The tokens of a run and the sessions that they opened."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self.now_s = now_s
        self.operator_token = secrets.token_urlsafe(TOKEN_BYTES)
        self.viewer_token = secrets.token_urlsafe(TOKEN_BYTES)
        self._sessions: dict[str, Session] = {}  # by cookie, oldest first
        self._pages = {role: Rate(PAGES, PAGES_S) for role in Role}

    def open(self, token: str, allowed: Collection[Role] = tuple(Role)) -> str | None:
        """The cookie of a new session for a token; None if it is not one of ours, or not in `allowed`."""
        roles = {self.operator_token: Role.OPERATOR, self.viewer_token: Role.VIEWER}
        given = token.encode()
        role = None
        for known, candidate in roles.items():  # both are always compared
            if secrets.compare_digest(known.encode(), given):
                role = candidate
        if role is None or role not in allowed:
            return None
        cookie = secrets.token_urlsafe(TOKEN_BYTES)
        self._sessions[cookie] = Session(role, secrets.token_hex(6))
        same = [kept for kept, session in self._sessions.items() if session.role is role]
        for oldest in same[:-MOST_SESSIONS]:
            del self._sessions[oldest]
        return cookie

    def may_open_page(self, role: Role) -> bool:
        """Whether this role has not opened too many pages lately; counts this one if so."""
        return self._pages[role].allows(self.now_s())

    def find(self, cookie: str | None) -> Session | None:
        """The session of a cookie."""
        return None if cookie is None else self._sessions.get(cookie)
