"""TCP server for one EKI channel, serving a single client and splitting the stream into requests.

The stream has no framing: a request ends with its root element. Anything before a root (NUL padding, line
ends, leftovers) is skipped; requests may arrive split or merged. The program reads one per loop of the submit
interpreter; unread ones wait in a buffer, and an overflow ends the connection.
"""

from __future__ import annotations

import contextlib
import re
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol
from xml.etree import ElementTree

from ronna_hw.bounded_input import InputRefused, parse_xml
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.port_users import find_tcp_listener
from sim.errors import EndpointTaken
from sim.world.client_sockets import receive_waiting

BUFFER_LIMIT_BYTES = 16384  # BUFFSIZE of an EKI channel
UNREAD_LIMIT = 512  # BUFFERING Limit: more unread values destroy the connection
GARBAGE = b"\xff\x00 what? />\r\n"
PADDING = b"\0" * 64
ANOTHER_PORT = (
    "Stop that program, or use free ports: --eki tcp://127.0.0.1:0 --eki-project tcp://127.0.0.1:0."
)

# Possessive quantifiers (*+): an unterminated tag must not take quadratic time.
_TAG = re.compile(rb"<(/?)([A-Za-z_][\w.:-]*+)(?:[^<>\"'/]|/(?!>)|\"[^\"<]*+\"|'[^'<]*+')*+(/?)>")
_OPENING = re.compile(rb"<[A-Za-z_]")


class Peer(Protocol):
    """Program behind a channel."""

    def client_connected(self) -> None:
        """Called when a client has connected."""

    def request(self, element: ElementTree.Element) -> None:
        """Called with each complete request."""

    def client_disconnected(self) -> None:
        """Called when the client has disconnected."""


class EkiServer:
    """Non-blocking server whose owner selects on `sockets`, calls `serve`, and calls `flush` at `due_s`.

    `spacing_s` is the program's loop time: at most one telegram is read and one written per loop.
    """

    def __init__(self, endpoint: Endpoint, spacing_s: float = 0.0) -> None:
        self._spacing_s = spacing_s
        self._listener = _listen(endpoint)
        self._client: socket.socket | None = None
        self._peer: Peer | None = None
        self._received = b""
        self._outgoing: deque[bytes] = deque()
        self._unread: deque[bytes] = deque()
        self._next_s = 0.0
        self._next_read_s = 0.0
        self.silent = False  # the program neither reads nor writes
        self.occupied = False  # fault: another client seems to hold the channel, new ones are refused
        self._corrupt: Callable[[bytes], bytes] | None = None  # corrupts the next telegram
        self._full = False

    def attach(self, peer: Peer) -> None:
        """Set the peer that handles requests."""
        self._peer = peer

    @property
    def endpoint(self) -> str:
        """Client endpoint, with the port actually bound if port 0 was requested."""
        host, port = self._listener.getsockname()[:2]
        return f"tcp://{host}:{port}"

    @property
    def connected(self) -> bool:
        """Whether a client is connected."""
        return self._client is not None

    @property
    def sockets(self) -> tuple[socket.socket, ...]:
        """Sockets to wait on."""
        return (self._listener,) if self._client is None else (self._listener, self._client)

    @property
    def due_s(self) -> float | None:
        """Host time of the next read or write by `flush`, or None if nothing is pending."""
        moments = [self._next_s] if self._outgoing else []
        if self._unread and not self.silent:
            moments.append(self._next_read_s)
        return min(moments) if moments else None

    @property
    def writes_later(self) -> bool:
        """Whether any telegrams are still queued for writing."""
        return bool(self._outgoing)

    def corrupt_next(self, how: Callable[[bytes], bytes]) -> None:
        """Apply `halve`, `prepend_garbage` or `pad_with_nul` to the next telegram for the present client."""
        self._corrupt = how if self.connected else None

    def fill_buffer(self) -> None:
        """Make the present client's next request overflow the buffer."""
        self._full = self.connected

    def serve(self, ready: socket.socket) -> None:
        """Handle a readable socket."""
        if ready is self._listener:
            self._accept()
        elif ready is self._client:
            self._read()

    def send(self, text: str) -> None:
        """Queue a telegram, to be written as soon as the spacing allows."""
        if self._client is not None and not self.silent:
            self._outgoing.append(text.encode("utf-8"))
            self._write()

    def flush(self) -> None:
        """Carry out due reads and writes."""
        self._dispatch()
        self._write()

    def _write(self) -> None:
        """Write due telegrams, one system call each."""
        while self._outgoing and self._client is not None:
            now_s = time.monotonic()
            if now_s < self._next_s:
                return
            telegram = self._outgoing.popleft()
            self._next_s = now_s + self._spacing_s
            if self._corrupt is not None:
                telegram, self._corrupt = self._corrupt(telegram), None
            try:
                if self._client.send(telegram) != len(telegram):
                    self.drop()  # the client does not read; half a telegram would break its framing
            except OSError:
                self.drop()

    def drop(self) -> None:
        """Disconnect the client."""
        client, self._client = self._client, None
        self._received = b""
        self._outgoing.clear()
        self._unread.clear()
        self._corrupt, self._full = None, False
        if client is not None:
            client.close()
            if self._peer is not None:
                self._peer.client_disconnected()

    def close(self) -> None:
        """Disconnect the client and stop listening."""
        self.drop()
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            client, _ = self._listener.accept()
            if self.occupied:
                client.close()
                return
            while self._client is not None:
                if not self._is_readable(self._client):
                    client.close()  # one client per channel
                    return
                self._read()  # the previous client's last data, and its disconnection
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
            self._next_s = time.monotonic() + self._spacing_s
            if self._peer is not None:
                self._peer.client_connected()

    @staticmethod
    def _is_readable(client: socket.socket) -> bool:
        """Return whether a client has sent something or disconnected."""
        try:
            client.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True
        return True

    def _read(self) -> None:
        assert self._client is not None
        if (data := receive_waiting(self._client)) is None:
            return
        if not data:
            self.drop()
            return
        requests, self._received = split_requests(self._received + data)
        self._unread.extend(requests)
        overflow = len(self._unread) > UNREAD_LIMIT or (self._full and bool(requests))
        if overflow or len(self._received) > BUFFER_LIMIT_BYTES:
            self.drop()  # buffered data are lost with the connection
            return
        self._dispatch()

    def _dispatch(self) -> None:
        """Pass pending requests to the program, one per loop time."""
        while self._unread and self._client is not None and not self.silent:
            now_s = time.monotonic()
            if now_s < self._next_read_s:
                return
            self._next_read_s = now_s + self._spacing_s
            request = self._unread.popleft()
            try:
                element = parse_xml(request, BUFFER_LIMIT_BYTES)
            except InputRefused:
                continue
            if self._peer is not None:
                self._peer.request(element)


def halve(telegram: bytes) -> bytes:
    """Return the first half of a telegram."""
    return telegram[: len(telegram) // 2]


def prepend_garbage(telegram: bytes) -> bytes:
    """Return a telegram preceded by garbage."""
    return GARBAGE + telegram


def pad_with_nul(telegram: bytes) -> bytes:
    """Return a telegram padded with NUL on both sides."""
    return PADDING + telegram + PADDING


def split_requests(stream: bytes) -> tuple[list[bytes], bytes]:
    """Split a stream into complete root elements and an incomplete remainder."""
    requests: list[bytes] = []
    position = 0
    while True:
        opening = _OPENING.search(stream, position)
        if opening is None:
            tail = stream.rfind(b"<", position)  # the first letter of a name may still come
            return requests, stream[tail:] if tail == len(stream) - 1 and tail >= 0 else b""
        begin = cursor = opening.start()
        depth = 0
        while True:
            tag = _TAG.search(stream, cursor)
            if tag is None:
                return requests, stream[begin:]
            cursor = tag.end()
            closing, _, empty = tag.groups()
            depth += -1 if closing else (0 if empty else 1)
            if depth <= 0:
                break
        requests.append(stream[begin:cursor])
        position = cursor


def _listen(endpoint: Endpoint) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    # A server that just ended leaves its port in TIME_WAIT; a running one still blocks it.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((endpoint.host, endpoint.port))
        listener.listen(1)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        holder = find_tcp_listener(endpoint.host, endpoint.port)
        raise EndpointTaken.from_system(error, str(endpoint), holder=holder, action=ANOTHER_PORT) from error
    return listener
