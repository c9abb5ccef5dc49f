"""Access control of the console: tokens, sessions, and a guard that denies by default.

A loopback address is no authentication: other users and every page in the same browser can reach it. A
request needs the right account of this computer, the right Host, the right Origin if it may change something,
and a session opened with a token. A run has two tokens, to view and to operate; a browser exchanges one for a
session.
"""

from __future__ import annotations

import copy
import secrets
import time
from collections import deque
from collections.abc import Awaitable, Callable, Collection, MutableMapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any
from urllib.parse import parse_qs

LOW = "low"  # option of a page: cheap graphics
TOKEN_BYTES = 32
MOST_SESSIONS = 64  # per role; the oldest is dropped for a new one
ORDERS_PER_SECOND = 10
PAGES, PAGES_S = 8, 4.0  # of a role in so many seconds: making one holds up everything else for tens of ms
Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]
OVERLOADED = 503
LARGEST_HEAD_BYTES = 16 * 1024  # a browser sends one or two thousand
LARGEST_BODY_BYTES = 65_536
MOST_FIELDS = 8  # of a query
SESSION = "ronna.session"  # key of a request's session in its scope
READ_METHODS = ("GET", "HEAD")
SOCKET_PATH = "/_nicegui_ws/"
HEADERS = {
    # The page library builds its page from inline scripts and compiles its templates: both must be allowed.
    "content-security-policy": "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self'; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
    "cache-control": "no-store",
}


class RateLimit:
    """Sliding-window rate limit of `count` per `span_s` seconds."""

    def __init__(self, count: int, span_s: float) -> None:
        self._span_s = span_s
        self._counted_s: deque[float] = deque(maxlen=count)

    def allows(self, now_s: float) -> bool:
        """Return whether another request is within the limit, and count it if so."""
        full = len(self._counted_s) == self._counted_s.maxlen
        if full and now_s - self._counted_s[0] < self._span_s:
            return False
        self._counted_s.append(now_s)
        return True


class SessionRole(StrEnum):
    """Role of a session, which determines its rights."""

    OPERATOR = "operator"
    VIEWER = "viewer"


@dataclass
class Session:
    """A browser's session. `identifier` may be shown and recorded; its cookie may not."""

    role: SessionRole
    identifier: str
    orders: RateLimit = field(default_factory=lambda: RateLimit(ORDERS_PER_SECOND, 1.0))


class Sessions:
    """The tokens of a run, and the sessions opened with them."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self.now_s = now_s
        self.operator_token = secrets.token_urlsafe(TOKEN_BYTES)
        self.viewer_token = secrets.token_urlsafe(TOKEN_BYTES)
        self._sessions: dict[str, Session] = {}  # by cookie, oldest first
        self._pages = {role: RateLimit(PAGES, PAGES_S) for role in SessionRole}

    def open(self, token: str, allowed: Collection[SessionRole] = tuple(SessionRole)) -> str | None:
        """Open a session for a token and return its cookie, or None if the token is unknown or disallowed."""
        roles = {self.operator_token: SessionRole.OPERATOR, self.viewer_token: SessionRole.VIEWER}
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

    def may_open_page(self, role: SessionRole) -> bool:
        """Return whether another page is within the limit of a role, and count it if so."""
        return self._pages[role].allows(self.now_s())

    def find(self, cookie: str | None) -> Session | None:
        """Return the session with this cookie, or None if there is none."""
        return None if cookie is None else self._sessions.get(cookie)


Trust = Callable[
    [object, SessionRole], bool
]  # of a connection, by host and port, that has shown the key of a role


MOST_CLIENTS = {
    SessionRole.OPERATOR: 4,
    SessionRole.VIEWER: 8,
}  # open pages; viewers leave room for the operator


class AccessGuard:
    """ASGI middleware that guards another application."""

    def __init__(
        self,
        app: App,
        sessions: Sessions,
        port: int,
        largest_body_bytes: int = LARGEST_BODY_BYTES,
        trust: Trust = lambda _peer, _role: True,
        is_foreign: Callable[[object], bool] = lambda _peer: False,
    ) -> None:
        """`trust` rejects a connection once its role has too many.

        `is_foreign` tells by host and port which connections another account of this computer has.
        """
        self._app = app
        self._sessions = sessions
        self._largest_body_bytes = largest_body_bytes
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._cookie = f"ronna_console_{port}"  # browsers do not separate ports
        self._scheme = "http"
        self._roles = frozenset(SessionRole)
        self._trust = trust
        self._is_foreign = is_foreign
        self.clients = dict.fromkeys(SessionRole, 0)  # open sockets

    def viewer_guard(self, host: str, trust: Trust = lambda _peer, _role: True) -> AccessGuard:
        """Return a guard for remote viewers of the same application, with TLS and no operator token.

        Its clients count towards the limits of this guard.
        """
        other = copy.copy(self)
        other._hosts, other._scheme, other._roles = {host}, "https", frozenset({SessionRole.VIEWER})
        other._trust = trust
        return other

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            await self._serve_http(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._serve_websocket(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _serve_http(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = _read_headers(scope)
        host = headers.get("host", "")
        if self._is_foreign(scope.get("client")):
            await _refuse(send, 403, "Open the page from the account of this computer that runs the console.")
            return
        if host not in self._hosts:
            await _refuse(send, 421, "This is not the console's address.")
            return
        if _head_bytes(scope) > LARGEST_HEAD_BYTES:
            await _refuse(send, 431, "Request head too large.")
            return
        if scope["method"] not in READ_METHODS and headers.get("origin") != f"{self._scheme}://{host}":
            await _refuse(send, 403, "The request does not come from a console page.")
            return
        if scope["path"] == "/" and scope["method"] == "GET" and (token := _read_token(scope)) is not None:
            await self._open_session(token, scope, send)
            return
        session = self._find_session(headers)
        if session is None:
            await _refuse(send, 401, "Open the address that the command printed: it contains the key.")
            return
        if scope["path"].startswith(SOCKET_PATH):
            await _refuse(send, 400, "WebSocket only.")
            return
        if not headers.get("content-length", "0").isdigit() or (
            int(headers.get("content-length", "0")) > self._largest_body_bytes
        ):
            await _refuse(send, 413, "Request too large.")
            return
        if not self._trust(scope.get("client"), session.role):
            await _refuse(send, OVERLOADED, "Too many connections are open. Close some pages and reload.")
            return
        if scope["path"] == "/" and not self._sessions.may_open_page(session.role):
            await _refuse(send, 429, "Too many pages were opened just now. Reload in some seconds.")
            return
        scope[SESSION] = session
        await self._app(scope, _limit_body(receive, self._largest_body_bytes), _with_headers(send))

    async def _open_session(self, token: str, scope: Scope, send: Send) -> None:
        cookie = self._sessions.open(token, self._roles)
        if cookie is None:
            await _refuse(send, 401, "This key belongs to another run, or is truncated.")
            return
        if (session := self._sessions.find(cookie)) is not None:
            # One too many stays a stranger until its next request.
            self._trust(scope.get("client"), session.role)
        kept = f"{self._cookie}={cookie}; HttpOnly; SameSite=Strict; Path=/"
        if self._scheme == "https":
            kept += "; Secure"
        await _answer(send, 303, b"", {"location": _address_without_token(scope), "set-cookie": kept})

    async def _serve_websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = _read_headers(scope)
        host = headers.get("host", "")
        allowed = (
            host in self._hosts
            and headers.get("origin") == f"{self._scheme}://{host}"
            and not self._is_foreign(scope.get("client"))
            and _head_bytes(scope) <= LARGEST_HEAD_BYTES
        )
        session = self._find_session(headers) if allowed else None
        if (
            session is None
            or self.clients[session.role] >= MOST_CLIENTS[session.role]
            or not self._trust(scope.get("client"), session.role)
        ):
            await receive()
            await send({"type": "websocket.close", "code": 1008})  # before acceptance: answered with 403
            return
        scope[SESSION] = session
        self.clients[session.role] += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self.clients[session.role] -= 1

    def _find_session(self, headers: dict[str, str]) -> Session | None:
        # Ours is never quoted; `http.cookies` takes quadratic time for quoted backslashes (CVE-2024-7592).
        # Any program on this computer can set one of the same name, which the browser may send first.
        pairs = (pair.strip().partition("=") for pair in headers.get("cookie", "").split(";"))
        found = (self._sessions.find(value) for name, _, value in pairs if name == self._cookie)
        return next((item for item in found if item is not None and item.role in self._roles), None)


def _read_headers(scope: Scope) -> dict[str, str]:
    """Return the headers by lower-case name, ignoring any that are duplicated."""
    found: dict[str, str] = {}
    repeated = set()
    for name, value in scope["headers"]:
        key = name.decode("latin-1").lower()
        repeated |= {key} & found.keys()
        found[key] = value.decode("latin-1")
    return {name: value for name, value in found.items() if name not in repeated}


def _head_bytes(scope: Scope) -> int:
    line = len(scope.get("raw_path") or b"") + len(scope["query_string"])
    return line + sum(len(name) + len(value) for name, value in scope["headers"])


def _read_token(scope: Scope) -> str | None:
    try:
        given = parse_qs(scope["query_string"].decode("latin-1"), max_num_fields=MOST_FIELDS).get("token")
    except ValueError:
        return ""
    return given[0] if given else None


def _address_without_token(scope: Scope) -> str:
    """Return where the page is, with the option that slow computers open it with, and nothing else."""
    options = parse_qs(scope["query_string"].decode("latin-1"), keep_blank_values=True)
    return f"/?{LOW}" if LOW in options else "/"


def _limit_body(receive: Receive, remaining_bytes: int) -> Receive:
    """Cut off a body that exceeds its limit, as if its sender had disconnected."""

    async def receive_limited() -> Message:
        nonlocal remaining_bytes
        message = await receive()
        remaining_bytes -= len(message.get("body", b""))
        return message if remaining_bytes >= 0 else {"type": "http.disconnect"}

    return receive_limited


def _with_headers(send: Send) -> Send:
    async def with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            ours = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
            kept = [
                item
                for item in message.get("headers", [])
                if item[0].decode("latin-1").lower() not in HEADERS
            ]
            message = {**message, "headers": [*kept, *ours]}
        await send(message)

    return with_headers


async def _refuse(send: Send, status: int, why: str) -> None:
    more = {"connection": "close"} if status == OVERLOADED else {}
    await _answer(send, status, why.encode(), {"content-type": "text/plain; charset=utf-8", **more})


async def _answer(send: Send, status: int, body: bytes, headers: dict[str, str]) -> None:
    with_length = {**headers, "content-length": str(len(body))}
    encoded_headers = [(name.encode(), value.encode("latin-1")) for name, value in with_length.items()]
    guarded = _with_headers(send)
    await guarded({"type": "http.response.start", "status": status, "headers": encoded_headers})
    await guarded({"type": "http.response.body", "body": body})
