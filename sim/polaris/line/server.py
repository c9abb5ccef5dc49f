"""Serves one host at a time until the process is asked to end."""

from __future__ import annotations

import os
import select
import socket
import time
from math import inf

from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.wire.polaris import REPLY_ERROR
from sim.errors import EndpointTaken
from sim.polaris.line.channel import Channel, Connection, Ready
from sim.polaris.line.framing import LineBuffer
from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.line.line_faults import LineFaults
from sim.polaris.line.pseudo_terminal import PseudoTerminal

REFUSED = REPLY_ERROR.encode("ascii")
WAITING_HOSTS = 4  # hosts that may queue for the connection
WAITING_LOOK_S = 0.2  # a silent host yields this long after the next one has connected


class EndSignal:
    """Wakes a waiting server from a signal handler or another thread."""

    def __init__(self) -> None:
        self._reader, self._writer = os.pipe()
        self.given = False

    def give(self) -> None:
        """Ask the server to end."""
        self.given = True
        os.write(self._writer, b"\0")

    def fileno(self) -> int:
        return self._reader


class Server:
    """Carries bytes between hosts and the command interpreter."""

    def __init__(self, interpreter: CommandInterpreter, end: EndSignal) -> None:
        self._interpreter = interpreter
        self._end = end
        self._listener: socket.socket | None = None
        self._silent_host_s = interpreter.unit.behaviour.silent_host_s
        self._silent_until_s = inf  # host time from which a silent host yields to a waiting one

    def serve_line(self, line: PseudoTerminal) -> None:
        """Serve a serial line."""
        self._converse(line)

    def serve_network(self, listener: socket.socket) -> None:
        """Serve connections one after another; the unit's state outlives them."""
        self._listener = listener
        waiting = self._poll(listener.fileno())
        while (ready := self._wait(waiting)) is not None:
            if not ready:
                self._interpreter.unasked()  # no host is connected
                continue
            connection = Connection(listener.accept()[0], self._silent_host_s)
            try:
                self._converse(connection)
            finally:
                self._silent_until_s = inf
                connection.close()

    def _converse(self, channel: Channel) -> None:
        interpreter = self._interpreter
        faults = LineFaults(interpreter.unit)
        lines = LineBuffer(interpreter.unit.model.longest_command)
        waiting = self._poll(*channel.files())
        self._hears()
        while (ready := self._wait(waiting)) is not None:
            if self._gives_way():
                return
            if unasked := interpreter.unasked():
                channel.send(unasked, interpreter.reply_line)
            received = channel.receive(ready) if ready else b""
            if received is None:
                return
            if not received:
                continue
            for line in lines.feed(received, time.monotonic()):
                channel.let_arrive(len(line) + 1, interpreter.line)
                line = faults.to_unit(line)
                reply = interpreter.reply(line)
                if not reply.startswith(REFUSED):
                    self._hears()
                reply = faults.to_host(line, reply)
                if reply:
                    channel.send(reply, interpreter.reply_line)

    def _hears(self) -> None:
        """The host has given a command that was not refused, or has just connected."""
        if self._listener is not None:
            self._silent_until_s = time.monotonic() + self._silent_host_s

    def _gives_way(self) -> bool:
        now_s = time.monotonic()
        if self._listener is None or now_s < self._silent_until_s:
            return False
        self._silent_until_s = now_s + WAITING_LOOK_S
        return bool(select.select([self._listener], [], [], 0.0)[0])

    def _poll(self, *files: int) -> select.poll:
        poll = select.poll()
        for file in (*files, self._end.fileno()):
            poll.register(file, select.POLLIN)
        return poll

    def _wait(self, poll: select.poll) -> Ready | None:
        """Wait for a host or until the unit has something to send; None when asked to end."""
        until_s = min(self._interpreter.due_s(), self._silent_until_s)
        wait_ms = max(0.0, until_s - time.monotonic()) * 1000.0
        ready = poll.poll(wait_ms)
        return None if self._end.given else ready


def network_address(text: str) -> Endpoint:
    """Parse the address to listen on; port 0 means any free one. Raises CFG-002 unless tcp://host:port."""
    return parse_endpoint(text, listening=True).require("tcp")


def listen(address: Endpoint) -> socket.socket:
    """Listen on the address; raises SIM-004 when it is taken."""
    try:
        return socket.create_server((address.host, address.port), backlog=WAITING_HOSTS)
    except OSError as error:
        reason = error.strerror or str(error)
        raise EndpointTaken(f"cannot listen on {address.host}:{address.port}: {reason}") from error
