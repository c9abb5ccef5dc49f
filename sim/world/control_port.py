"""The control port: JSON lines over TCP on loopback, one answer per line, for clients with the token.

A theatre has one, and so does each simulator started alone. Every process on this computer can connect to it,
including a page in a browser, so a connection is trusted only if its first line is `{"token": "..."}` with
the token from the READY line. It is closed at the first line that is too long or no JSON object, and when no
line arrives for a while. Connections without the token cannot keep out those with it.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import secrets
import socket
import socketserver
import threading
import time
from typing import Any

from ronna_hw.bounded_input import parse_json
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.control_port import LONGEST_LINE, TOKEN_KEY, ControlAddress
from sim.world.control import Room

TOKEN_BYTES = 16  # from the system's random source: unguessable
MOST_CONNECTIONS = 8
FIRST_LINE_LIMIT_S = 2.0  # host time, from the connection to the complete first line
IDLE_LIMIT_S = 10.0  # host time, from one line to the complete next one
NO_TOKEN = {"ok": False, "reason": "expected the token from the READY line in the first line"}


class ControlPort:
    """Serves the room on a free loopback port until closed."""

    def __init__(
        self,
        room: Room,
        *,
        first_line_limit_s: float = FIRST_LINE_LIMIT_S,
        idle_limit_s: float = IDLE_LIMIT_S,
    ) -> None:
        limits_s = (first_line_limit_s, idle_limit_s)
        self._server = _Server(room, secrets.token_urlsafe(TOKEN_BYTES), limits_s)
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    @property
    def endpoint(self) -> str:
        """Where the operator connects, including the token: a secret."""
        where = Endpoint("tcp", "127.0.0.1", self._server.server_address[1])
        return ControlAddress(where, self._server.token).text()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    block_on_close = False

    def __init__(self, room: Room, token: str, limits_s: tuple[float, float]) -> None:
        super().__init__(("127.0.0.1", 0), _Conversation)
        self.room = room
        self.token = token
        self.limits_s = limits_s
        self.strangers: list[socket.socket] = []  # have not shown the token yet, oldest first
        self.trusted: list[socket.socket] = []
        self.changing = threading.Lock()

    def verify_request(self, request: socket.socket | tuple[bytes, socket.socket], _address: Any) -> bool:
        """If there are too many, the stranger who has waited longest is dropped."""
        assert isinstance(request, socket.socket)
        with self.changing:
            if len(self.trusted) == MOST_CONNECTIONS:
                return False
            if len(self.strangers) + len(self.trusted) == MOST_CONNECTIONS:
                with contextlib.suppress(OSError):
                    self.strangers.pop(0).shutdown(socket.SHUT_RDWR)
            self.strangers.append(request)
        return True


class _Conversation(socketserver.BaseRequestHandler):
    request: socket.socket
    server: _Server

    def handle(self) -> None:
        self._received = b""
        with contextlib.suppress(OSError, _HangUp):  # the operator disconnected abruptly
            first_line_limit_s, idle_limit_s = self.server.limits_s
            token = self._next(first_line_limit_s).get(TOKEN_KEY)
            if not hmac.compare_digest(str(token).encode(errors="replace"), self.server.token.encode()):
                self._answer(NO_TOKEN)
                return
            self._trust()
            self._answer({"ok": True})
            while True:
                self._answer(self.server.room.answer(self._next(idle_limit_s)))

    def finish(self) -> None:
        with self.server.changing:
            for those in (self.server.strangers, self.server.trusted):
                if self.request in those:
                    those.remove(self.request)

    def _trust(self) -> None:
        with self.server.changing:
            if self.request not in self.server.strangers:
                raise _HangUp  # was dropped at this very moment
            self.server.strangers.remove(self.request)
            self.server.trusted.append(self.request)

    def _next(self, limit_s: float) -> dict[str, Any]:
        """The next line, a JSON object; hangs up on anything else, and if it does not arrive in time."""
        deadline = time.monotonic() + limit_s
        while b"\n" not in self._received:
            self.request.settimeout(max(deadline - time.monotonic(), 0.001))
            more = self.request.recv(LONGEST_LINE)
            if not more or len(self._received) > LONGEST_LINE or time.monotonic() > deadline:
                raise _HangUp
            self._received += more
        line, _, self._received = self._received.partition(b"\n")
        try:
            request = parse_json(line, LONGEST_LINE)
        except ValueError:
            raise _HangUp from None
        if not isinstance(request, dict):
            raise _HangUp
        return request

    def _answer(self, answer: dict[str, Any]) -> None:
        self.request.settimeout(self.server.limits_s[1])
        self.request.sendall(json.dumps(answer).encode() + b"\n")


class _HangUp(Exception):
    """The conversation is over."""
