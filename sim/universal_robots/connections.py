"""Listening sockets and client connections, non-blocking, for one `select` loop."""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from ipaddress import IPv4Address

from ronna_hw.command_line.terminal import tell
from ronna_hw.host.port_users import find_tcp_listener
from sim.errors import EndpointTaken
from sim.world.client_sockets import receive_waiting

MOST_HELD_BYTES = 1 << 20  # while nothing passes, beyond which the controller gives up a connection
NO_ROOM = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)  # a client waits, and cannot be accepted
ACCEPT_PAUSE_S = 1.0  # host time until it is tried again: a waiting client is readable all the time
MOST_ADDRESSES = 32  # looked at for a free one: each arm of a room has one


class Poll:
    """Sockets to wait on, each with what to do when it is readable."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._actions: dict[int, Callable[[], None]] = {}
        self._paused: dict[socket.socket, tuple[float, Callable[[], None]]] = {}

    def register(self, one: socket.socket, action: Callable[[], None]) -> None:
        """Add a socket to wait for."""
        self._paused.pop(one, None)
        self._actions[one.fileno()] = action
        self._epoll.register(one, select.EPOLLIN)

    def unregister(self, one: socket.socket) -> None:
        """Remove a socket; does nothing if it is not registered."""
        self._paused.pop(one, None)
        if self._actions.pop(one.fileno(), None) is not None:
            self._epoll.unregister(one)

    def pause(self, one: socket.socket, pause_s: float) -> None:
        """Wait for a socket again after some host time."""
        action = self._actions[one.fileno()]
        self.unregister(one)
        self._paused[one] = time.monotonic() + pause_s, action

    def serve(self, timeout_s: float) -> None:
        """Wait once and run the actions of all readable sockets."""
        for one, (until_s, resumed) in tuple(self._paused.items()):
            if time.monotonic() >= until_s:
                self.register(one, resumed)
        actions = self._actions
        for number, _ in self._epoll.poll(timeout_s):
            action = actions.get(number)
            if action is not None:  # else closed a moment ago
                action()

    def close(self) -> None:
        """Stop waiting."""
        self._epoll.close()


class Handler(ABC):
    """Program behind a connection."""

    @abstractmethod
    def receive(self, data: bytes) -> bytes:
        """Take bytes from the client and return the answer, perhaps empty; raises HangUp."""

    def closed(self) -> None:  # noqa: B027 - most programs end by themselves
        """Take note that the connection has been closed."""


class HangUp(Exception):
    """The connection is closed after these last bytes."""

    def __init__(self, last: bytes = b"") -> None:
        super().__init__()
        self.last = last


class ClientConnection:
    """Connection to a client, closed once the client stops reading."""

    def __init__(self, client: socket.socket, poll: Poll, forget: Callable[[ClientConnection], None]) -> None:
        self.socket = client
        self._poll, self._forget = poll, forget
        self.handler: Handler | None = None
        self.open = True
        self._is_deaf = False
        self._held: list[bytes] | None = None  # what waits while nothing passes
        self._held_bytes = 0
        poll.register(client, self.serve)

    def serve(self) -> None:
        """Read what has arrived, and answer."""
        assert self.handler is not None
        if (data := receive_waiting(self.socket)) is None:
            return
        if not data:
            self.close()
            return
        try:
            answer = self.handler.receive(data)
        except HangUp as hang_up:
            if hang_up.last:
                self.send(hang_up.last)
            self.close()
            return
        if answer:
            self.send(answer)

    def send(self, data: bytes) -> None:
        """Send, or close the connection if the client does not read."""
        if self._held is not None:
            self._held.append(data)
            self._held_bytes += len(data)
            if self._held_bytes > MOST_HELD_BYTES:
                self.close()
            return
        try:
            if self.socket.send(data) == len(data):
                return
        except OSError:
            pass
        self.close()

    def hold(self, *, holds: bool) -> None:
        """Suspend traffic in both directions, or resume it and send what was held back."""
        if holds is (self._held is not None) or not self.open:
            return
        if holds:
            self._held = []
            self._poll.unregister(self.socket)
            return
        waiting, self._held, self._held_bytes = self._held or [], None, 0
        self._poll.register(self.socket, self.serve)
        if waiting:
            self.send(b"".join(waiting))

    def send_while_read(self, data: bytes) -> None:
        """Send, until once there is no room: a client that never reads may still command."""
        if self._held is not None or self._is_deaf:
            return
        try:
            self._is_deaf = self.socket.send(data) != len(data)
        except BlockingIOError:
            self._is_deaf = True
        except OSError:
            self.close()

    def close(self) -> None:
        """Close the connection; safe to call twice."""
        if not self.open:
            return
        self.open = False
        self._poll.unregister(self.socket)
        self.socket.close()
        self._forget(self)
        if self.handler is not None:
            self.handler.closed()


class ServiceListener:
    """Accepts clients of one port."""

    def __init__(
        self,
        address: str,
        port: int,
        poll: Poll,
        connect: Callable[[ClientConnection], Handler | None],
        *,
        send_buffer_bytes: int = 0,
    ) -> None:
        self._poll, self._connect = poll, connect
        self._send_buffer_bytes = send_buffer_bytes
        self.connections: tuple[ClientConnection, ...] = ()  # open ones
        self._holds = False
        self._has_room = True
        self._socket = _listen(address, port)
        poll.register(self._socket, self._accept)

    @property
    def endpoint(self) -> str:
        """Endpoint of the clients."""
        host, port = self._socket.getsockname()[:2]
        return f"tcp://{host}:{port}"

    def hold(self, *, holds: bool) -> None:
        """Suspend all traffic and new connections, or resume both."""
        if holds is self._holds:
            return
        self._holds = holds
        for connection in self.connections:
            connection.hold(holds=holds)
        if holds:
            self._poll.unregister(self._socket)
        else:
            self._poll.register(self._socket, self._accept)

    def drop_all(self) -> None:
        """Close all connections."""
        for connection in self.connections:
            connection.close()

    def close(self) -> None:
        """Close all connections and stop listening."""
        self.drop_all()
        self._poll.unregister(self._socket)
        self._socket.close()

    def _accept(self) -> None:
        try:
            client, _ = self._socket.accept()
        except OSError as error:
            if error.errno in NO_ROOM:
                self._wait_for_room(error)
            return
        self._has_room = True
        with contextlib.suppress(OSError):
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if self._send_buffer_bytes:
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._send_buffer_bytes)
            connection = ClientConnection(client, self._poll, self._forget)
            self.connections = (*self.connections, connection)
            connection.handler = self._connect(connection)
            if connection.handler is None:
                connection.close()

    def _wait_for_room(self, error: OSError) -> None:
        """Let a client wait, and say so once."""
        self._poll.pause(self._socket, ACCEPT_PAUSE_S)
        if self._has_room:
            self._has_room = False
            tell(f"warning: {self.endpoint} cannot accept a client ({error.strerror}); it is tried again")

    def _forget(self, connection: ClientConnection) -> None:
        self.connections = tuple(one for one in self.connections if one is not connection)


def _listen(address: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    # A server that just ended leaves its port in TIME_WAIT; a running one still blocks it.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((address, port))
        listener.listen()
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        holder = find_tcp_listener(address, port)
        raise EndpointTaken.from_system(
            error,
            f"tcp://{address}:{port}",
            holder=holder,
            action=f"Stop that program, or give an address of its own: --address {find_free(address, port)}.",
        ) from error
    return listener


def find_free(first: str, port: int) -> str:
    """Return the first address of this computer from `first` on whose port nobody uses."""
    addresses = [str(IPv4Address(first) + number) for number in range(MOST_ADDRESSES)]
    return next((one for one in addresses if _is_free(one, port)), addresses[-1])


def _is_free(address: str, port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            one.bind((address, port))
        except OSError:
            return False
        return True
