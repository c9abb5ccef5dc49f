"""Server for one host at a time, over a serial line or TCP, until the process is told to end."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from collections.abc import Sequence
from math import inf
from typing import Protocol

from ronna_hw.endpoints import Endpoint
from ronna_hw.host.port_users import find_tcp_listener
from ronna_hw.wire.polaris import REPLY_ERROR
from sim.errors import EndpointTaken
from sim.polaris.faults import LineFaults
from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.unit.framing import LineBuffer, LineSettings

RECEIVE_BYTES = 4096
Ready = Sequence[tuple[int, int]]  # (file descriptor, events) as `poll` returns them
SEND_PATIENCE_S = 5.0  # a host that has read nothing for this long is gone, whatever the unit's own limit

REFUSED = REPLY_ERROR.encode("ascii")
WAITING_HOSTS = 4  # hosts that may queue for the connection
WAITING_CHECK_S = 0.2  # host time between checks for a waiting host


class Channel(Protocol):
    """A byte stream to one host."""

    def files(self) -> tuple[int, ...]:
        """Return the file descriptors to wait on."""
        ...

    def receive(self, ready: Ready) -> bytes | None:
        """Read the ready descriptors and return the bytes (possibly none), or None if the host has left."""
        ...

    def wait_for_arrival(self, received_bytes: int, line: LineSettings) -> None:
        """Wait for as long as the bytes would take to arrive with these line settings."""
        ...

    def send(self, data: bytes, line: LineSettings) -> None:
        """Send a reply with these line settings."""
        ...


class HostConnection:
    """TCP connection to a host, treated as lost if it accepts no reply for `patience_s`."""

    def __init__(self, peer: socket.socket, patience_s: float) -> None:
        self._peer = peer
        self._gone = False
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.settimeout(min(patience_s, SEND_PATIENCE_S))

    def files(self) -> tuple[int, ...]:
        return (self._peer.fileno(),)

    def receive(self, ready: Ready) -> bytes | None:
        if self._gone:  # commands still in its buffer are not executed
            return None
        try:
            return self._peer.recv(RECEIVE_BYTES) or None
        except OSError:
            return None

    def wait_for_arrival(self, received_bytes: int, line: LineSettings) -> None:
        """Return at once, because a network has no baud rate."""

    def send(self, data: bytes, line: LineSettings) -> None:
        try:
            self._peer.sendall(data)
        except OSError:  # half a reply is useless: make the next receive report the host as gone
            self._gone = True
            with contextlib.suppress(OSError):
                self._peer.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection."""
        self._peer.close()


class EndSignal:
    """Wakes a waiting server from a signal handler or another thread."""

    def __init__(self) -> None:
        self._reader, self._writer = os.pipe()
        self.given = False

    def give(self) -> None:
        """Ask the server to end; safe in a signal handler."""
        self.given = True
        os.write(self._writer, b"\0")

    def fileno(self) -> int:
        return self._reader


class Server:
    """Transfers bytes between hosts and the command interpreter."""

    def __init__(self, interpreter: CommandInterpreter, end: EndSignal) -> None:
        self._interpreter = interpreter
        self._end = end
        self._listener: socket.socket | None = None
        self._silent_host_s = interpreter.unit.behaviour.silent_host_s
        self._silent_until_s = inf  # host time from which a silent host yields to a waiting one

    def serve_network(self, listener: socket.socket) -> None:
        """Serve connections one after another, preserving the unit's state between them."""
        self._listener = listener
        waiting = self._poll(listener.fileno())
        while (ready := self._wait(waiting)) is not None:
            if not ready:
                self._interpreter.unsolicited_bytes()  # no host is connected
                continue
            connection = HostConnection(listener.accept()[0], self._silent_host_s)
            try:
                self.serve_channel(connection)
            finally:
                self._silent_until_s = inf
                connection.close()

    def serve_channel(self, channel: Channel) -> None:
        """Serve one host until it leaves, or indefinitely on a serial line, which hosts open and close."""
        interpreter = self._interpreter
        faults = LineFaults(interpreter.unit)
        lines = LineBuffer(interpreter.unit.model.longest_command)
        waiting = self._poll(*channel.files())
        self._restart_silence()
        while (ready := self._wait(waiting)) is not None:
            if self._must_yield():
                return
            if unsolicited_bytes := interpreter.unsolicited_bytes():
                channel.send(unsolicited_bytes, interpreter.reply_line)
            received = channel.receive(ready) if ready else b""
            if received is None:
                return
            if not received:
                continue
            for line in lines.feed(received, time.monotonic()):
                channel.wait_for_arrival(len(line) + 1, interpreter.unit.line)
                line = faults.to_unit(line)
                reply = interpreter.reply(line)
                if not reply.startswith(REFUSED):
                    self._restart_silence()
                reply = faults.to_host(line, reply)
                if reply:
                    channel.send(reply, interpreter.reply_line)

    def _restart_silence(self) -> None:
        """Restart the silence limit, because the host has connected or sent a valid command."""
        if self._listener is not None:
            self._silent_until_s = time.monotonic() + self._silent_host_s

    def _must_yield(self) -> bool:
        """Return whether a silent network host must yield to another waiting host."""
        now_s = time.monotonic()
        if self._listener is None or now_s < self._silent_until_s:
            return False
        self._silent_until_s = now_s + WAITING_CHECK_S
        return bool(select.select([self._listener], [], [], 0.0)[0])

    def _poll(self, *files: int) -> select.poll:
        poll = select.poll()
        for file in (*files, self._end.fileno()):
            poll.register(file, select.POLLIN)
        return poll

    def _wait(self, poll: select.poll) -> Ready | None:
        """Wait for a host or until the unit has output; return None when asked to end."""
        until_s = min(self._interpreter.due_s(), self._silent_until_s)
        wait_ms = max(0.0, until_s - time.monotonic()) * 1000.0
        ready = poll.poll(wait_ms)
        return None if self._end.given else ready


def listen(address: Endpoint) -> socket.socket:
    """Listen on an address; raises SIM-004 if it is in use."""
    try:
        return socket.create_server((address.host, address.port), backlog=WAITING_HOSTS)
    except OSError as error:
        holder = find_tcp_listener(address.host, address.port)
        raise EndpointTaken.from_system(error, f"{address.host}:{address.port}", holder=holder) from error
