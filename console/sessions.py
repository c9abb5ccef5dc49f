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


class Role(StrEnum):
    """What a session may do."""

    OPERATOR = "operator"
    VIEWER = "viewer"


@dataclass
class Session:
    """One browser. `identifier` may be shown and recorded; the content of its cookie may not."""

    role: Role
    identifier: str
    orders_s: deque[float] = field(default_factory=lambda: deque(maxlen=ORDERS_PER_SECOND))

    def may_order(self, now_s: float) -> bool:
        """Whether it has not given too many orders in the last second; counts this one."""
        full = len(self.orders_s) == ORDERS_PER_SECOND
        if full and now_s - self.orders_s[0] < 1.0:
            return False
        self.orders_s.append(now_s)
        return True


class Sessions:
    """The tokens of a run and the sessions that they opened."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self.now_s = now_s
        self.operator_token = secrets.token_urlsafe(TOKEN_BYTES)
        self.viewer_token = secrets.token_urlsafe(TOKEN_BYTES)
        self._sessions: dict[str, Session] = {}  # by cookie, oldest first

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

    def find(self, cookie: str | None) -> Session | None:
        """The session of a cookie."""
        return None if cookie is None else self._sessions.get(cookie)
