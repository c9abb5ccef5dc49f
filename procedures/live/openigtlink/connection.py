"""Connection of one client: one slot per type and name, which newer values replace, so that nobody waits.

The header is of version 1 until the client has sent one of version 2, unless the server is told otherwise:
peers of protocol 2 would read garbage.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Hashable
from typing import Final, Protocol, cast

from procedures.live.openigtlink.outgoing import Outgoing, Sendable
from procedures.live.openigtlink.throttle import Throttle
from ronna_hw.wire.openigtlink import Message, MessageReader, StreamBroken

PIECE_BYTES: Final = 1 << 18  # given to the socket at once: an image waits outside the transport, uncopied
SEND_BUFFER_BYTES: Final = 1 << 16  # of the kernel: what waits there is old by the time it is read
TAKEN_BYTES_PER_S: Final = 1 << 18  # from a client, who has only short questions
MOST_REPLIES: Final = 64  # to questions, that wait; further ones replace them
KEEPALIVE: Final = {socket.TCP_KEEPIDLE: 10, socket.TCP_KEEPINTVL: 5, socket.TCP_KEEPCNT: 3}  # s, s, times


class ConnectionOwner(Protocol):
    """The server, as a connection knows it."""

    def admit(self, connection: Connection) -> None:
        """Take up a new connection, or refuse it."""

    def welcome(self, connection: Connection) -> None:
        """Send a connection all that stands."""

    def dismiss(self, connection: Connection) -> None:
        """Forget a connection that is closed."""

    def receive(self, connection: Connection, message: Message) -> None:
        """Take a message of a client; it may have a fault."""

    def break_off(self, connection: Connection, reason: str) -> None:
        """Take note that a client's stream cannot be read on."""


class Connection(asyncio.Protocol):
    """Connected client."""

    def __init__(self, owner: ConnectionOwner, version: int) -> None:
        self.version = version
        self.stalled_since_s: float | None = None  # loop time since which the client takes nothing
        self.has_image_request = False
        self._owner = owner
        self._loop = asyncio.get_running_loop()
        self._reader = MessageReader()
        self._slots: dict[Hashable, Sendable] = {}
        self._sending = memoryview(b"")
        self._subscriptions: dict[str, Throttle[None]] = {}  # by type: TDATA, QTDATA
        self._replies = 0
        self._is_woken = self._is_closing = False
        self._transport: asyncio.Transport

    def offer(self, value: Sendable) -> None:
        """Send a value as soon as the client takes it. Only while it takes nothing a newer one replaces it.

        A pose that is not valid takes back the one that waits, and goes only to clients with metadata.
        """
        if value.needs_metadata and self.version == 1:
            self._slots.pop(value.key, None)
            return
        if value.key in self._slots and self.stalled_since_s is None:
            self._send()
        self._slots[value.key] = value
        self._wake()

    def reply(self, answer: Sendable) -> None:
        """Send an answer, which newer values do not replace."""
        self._slots["reply", self._replies % MOST_REPLIES] = answer
        self._replies += 1
        self._wake()

    def subscribe(self, kind: str, interval_s: float, make: Callable[[], Outgoing]) -> None:
        """Send what `make` returns at changes of poses, at most once per interval."""
        self._subscriptions[kind] = Throttle(interval_s, lambda _: self.offer(make()))

    def unsubscribe(self, kind: str) -> None:
        """End the subscription for a type, if there is one."""
        if (throttle := self._subscriptions.pop(kind, None)) is not None:
            throttle.close()

    def note_pose(self) -> None:
        """Note that a pose has changed."""
        for throttle in self._subscriptions.values():
            throttle.offer(None)

    def close(self) -> None:
        """Close the connection once everything is sent."""
        self._is_closing = True
        self._wake()

    def abort(self) -> None:
        """Close the connection now."""
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin: keep-alives find a peer that is gone, a small buffer keeps values young."""
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=0)
        connected = transport.get_extra_info("socket")
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for option, value in KEEPALIVE.items():
            connected.setsockopt(socket.IPPROTO_TCP, option, value)
        self._owner.admit(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        for throttle in self._subscriptions.values():
            throttle.close()
        self._owner.dismiss(self)

    def data_received(self, data: bytes) -> None:
        """Take questions, and no more bytes than a client may send in a second."""
        if self._is_closing:
            return
        try:
            for message in self._reader.feed(data):
                if message.version > self.version and not message.fault:
                    self.version = message.version
                    self._owner.welcome(self)  # again, now with metadata
                self._owner.receive(self, message)
        except StreamBroken as broken:
            self._owner.break_off(self, str(broken))
        self._transport.pause_reading()
        self._loop.call_later(len(data) / TAKEN_BYTES_PER_S, self._transport.resume_reading)

    def pause_writing(self) -> None:
        """Note that the client takes no more."""
        self.stalled_since_s = self._loop.time()

    def resume_writing(self) -> None:
        """Send what has come meanwhile."""
        self.stalled_since_s = None
        self._wake()

    def _wake(self) -> None:
        """Send at the end of this round of the loop: values that come together go together."""
        if not self._is_woken and self.stalled_since_s is None:
            self._is_woken = True
            self._loop.call_soon(self._send_woken)

    def _send_woken(self) -> None:
        self._is_woken = False
        self._send()

    def _send(self) -> None:
        while self.stalled_since_s is None:
            if not self._sending and not self._take_slots():
                if self._is_closing:
                    self._transport.close()
                return
            piece, self._sending = self._sending[:PIECE_BYTES], self._sending[PIECE_BYTES:]
            self._transport.write(piece)

    def _take_slots(self) -> bool:
        """Take the values that wait, up to an image, which is sent alone."""
        taken: list[bytes] = []
        for key, value in list(self._slots.items()):
            encoded = value.encoded(self.version)
            if len(encoded) > PIECE_BYTES and taken:
                break
            del self._slots[key]
            taken.append(encoded)
            if len(encoded) > PIECE_BYTES:
                break
        self._sending = memoryview(taken[0] if len(taken) == 1 else b"".join(taken))
        return bool(taken)
