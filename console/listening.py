"""Listening sockets and connections of the console, on loopback and at an address for remote viewers.

A request has little time to arrive. The guard sees it only after its head is complete, so incomplete heads
are limited here.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from console.errors import PORT_TAKEN
from console.guard import LARGEST_BODY_BYTES, LARGEST_HEAD_BYTES, AccessGuard, SessionRole
from ronna_hw.command_line.viewers_address import ViewersAddress
from ronna_hw.host.network import find_account

REQUEST_LIMIT_S = 5.0  # host time, from the connection or the last answer to the complete next head
ANSWER_LIMIT_S = 60.0  # host time from there until the answer was taken: five megabytes by a slow line
HOST = "127.0.0.1"
BACKLOG = 32  # also the most that the loop accepts at a time
MOST_STRANGERS = 8 * BACKLOG  # the loop reaches a request long before as many others have come after it
MOST_CONNECTIONS = {SessionRole.OPERATOR: 32, SessionRole.VIEWER: 64}  # with a session; a browser opens seven
SOCKET_BYTES = 4 * LARGEST_BODY_BYTES  # the page library sends some messages of its own


def listen(address: str, port: int, family: socket.AddressFamily = socket.AF_INET) -> ListeningSocket:
    """Open a listening socket. Port 0 selects any free port. Raises CON-001."""
    listening = ListeningSocket(family)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((address, port))
    except OSError as error:
        listening.close()
        raise PORT_TAKEN(f"port {port} of {address} cannot be used: {error.strerror}") from error
    listening.listen(BACKLOG)
    return listening


def build_server(guard: AccessGuard, viewers: ViewersAddress | None = None) -> uvicorn.Server:
    """Build a server for the guarded application, with TLS if it is for `viewers`."""
    tls = {} if viewers is None else {"ssl_certfile": viewers.certificate, "ssl_keyfile": str(viewers.key)}
    return uvicorn.Server(
        uvicorn.Config(
            guard,
            http=Connection,
            h11_max_incomplete_event_size=LARGEST_HEAD_BYTES,
            backlog=BACKLOG,
            proxy_headers=False,  # an address in a header is anyone's claim
            log_config=None,
            access_log=False,  # an address may contain a key
            lifespan="on" if viewers is None else "off",  # the pages start once
            ws="websockets-sansio",  # `Connection` knows its protocol
            ws_max_size=SOCKET_BYTES,
            ws_per_message_deflate=False,  # all clients are near
            timeout_graceful_shutdown=1,
            server_header=False,
            **tls,  # type: ignore[arg-type]  # files by name, as uvicorn takes them
        )
    )


class ListeningSocket(socket.socket):
    """Listening socket that drops the oldest unauthenticated connection when there are too many.

    On loopback it remembers which connections are of another account of this computer.
    """

    def __init__(self, family: socket.AddressFamily) -> None:
        # The loop recognises TCP by the protocol and then disables Nagle's delay, which can hold
        # an answer for 40 ms.
        super().__init__(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        self._strangers: dict[object, socket.socket] = {}  # by host and port, oldest first
        self._foreign: dict[object, socket.socket] = {}  # likewise, of other accounts
        self._known: dict[SessionRole, dict[object, socket.socket]] = {
            role: {} for role in SessionRole
        }  # with a session

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept the next connection, before authentication and any TLS handshake."""
        connection, address = super().accept()
        self._strangers, self._foreign = _still_open(self._strangers), _still_open(self._foreign)
        if len(self._strangers) >= MOST_STRANGERS:
            oldest = self._strangers.pop(next(iter(self._strangers)))
            with contextlib.suppress(OSError):  # has just gone by itself
                oldest.shutdown(socket.SHUT_RDWR)
        self._strangers[address[:2]] = connection
        here = connection.getsockname()
        if here[0] == HOST and find_account(address, here) != os.geteuid():
            self._foreign[address[:2]] = connection
        return connection, address

    def is_foreign(self, peer: object) -> bool:
        """Return whether the connection from this host and port belongs to another account on this computer.

        Cookies are not bound to a port: a browser shows ours to every server on loopback that it visits.
        """
        return peer in self._foreign

    def trust(self, peer: object, role: SessionRole) -> bool:
        """Mark an authenticated connection as trusted. Return False if its role has too many connections."""
        if peer not in self._strangers:
            return True
        known = self._known[role] = _still_open(self._known[role])
        if len(known) >= MOST_CONNECTIONS[role]:
            return False
        known[peer] = self._strangers.pop(peer)
        return True


def _still_open(connections: dict[object, socket.socket]) -> dict[object, socket.socket]:
    return {peer: item for peer, item in connections.items() if item.fileno() != -1}


class Connection(H11Protocol):
    """HTTP/1.1 connection with time limits for receiving a request head and sending a response."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._deadline: asyncio.TimerHandle | None = None
        self._is_answering = False
        self._answer_ends_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
        """Start the timeout for the first request."""
        super().connection_made(transport)
        self._wait(REQUEST_LIMIT_S)

    def handle_events(self) -> None:
        """Start the response timeout once the request head is complete."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete and not self._is_answering:
            self._is_answering = True
            self._answer_ends_s = self.loop.time() + ANSWER_LIMIT_S
            self._wait(ANSWER_LIMIT_S)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Leave the socket to the guard, which closes sockets without a session.

        A head that the socket's protocol refuses, for a long line, is neither answered nor seen by the guard.
        """
        self._stop_waiting()
        super().handle_websocket_upgrade(event)
        if not getattr(self.transport.get_protocol(), "handshake_initiated", False):
            self.transport.abort()

    def on_response_complete(self) -> None:
        """Start the timeout for the next request."""
        self._is_answering = False
        self._wait(REQUEST_LIMIT_S)
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        super().connection_lost(exc)

    def _wait(self, limit_s: float) -> None:
        self._stop_waiting()
        self._deadline = self.loop.call_later(limit_s, self._end)

    def _end(self) -> None:
        """Drop the connection, unless a complete response is still being sent to a slow reader."""
        remaining_s = self._answer_ends_s - self.loop.time()
        if remaining_s > 0.0 and not self._is_answering and self.transport.get_write_buffer_size() > 0:
            self._wait(min(remaining_s, REQUEST_LIMIT_S))
        else:
            self.transport.abort()

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
