"""Exchange of RTDE packages: receive, answer with the prepared set-point or a new one."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from typing import NamedTuple

from drivers.universal_robots.realtime.line import Rehearsal, RtdeLine, is_output
from drivers.universal_robots.realtime.packages import HEAD, OUTPUT, START_REQUEST
from drivers.universal_robots.realtime.session import RtdeSession
from drivers.universal_robots.realtime.settings import LinkSettings
from ronna_hw.arm_stream.loop import StreamLoop
from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.records import Command, OpenStream, StreamPhase
from ronna_hw.wire.universal_robots import PackageType, SafetyMode

BUNCH_S = 200e-6  # in which packages that were delayed together arrive
_HANDOVER = struct.Struct("<BBiB")


class Handover(NamedTuple):
    """Recipes of a connection, the random number of its session, and the safety mode of its limits."""

    output_recipe: int
    input_recipe: int
    run: int
    safety_mode: int = SafetyMode.NORMAL

    def give(self, channel: socket.socket, connection: socket.socket) -> None:
        """Give a connection to the process at the other end of a local socket; raises OSError."""
        socket.send_fds(channel, [_HANDOVER.pack(*self)], [connection.fileno()])


def take_connection(channel: socket.socket) -> tuple[Handover, socket.socket] | None:
    """Take the connection that was given last from a channel that does not block; None without one."""
    taken: tuple[Handover, socket.socket] | None = None
    with contextlib.suppress(OSError, struct.error):
        while True:
            data, descriptors, _, _ = socket.recv_fds(channel, _HANDOVER.size, 1)
            if not data:
                break
            if taken is not None:
                taken[1].close()
            taken = Handover(*_HANDOVER.unpack(data)), socket.socket(fileno=descriptors[0])
    return taken


class LinkLoop(StreamLoop):
    """Main loop of the real-time process; ends once the parent has exited and the arm is at rest."""

    session: RtdeSession

    def __init__(
        self,
        settings: LinkSettings,
        channel: socket.socket,
        mailbox: Mailbox,
        *,
        real_time: bool = False,
        locked: bool = False,
    ) -> None:
        """Take connections from `channel`."""
        self._rtde = RtdeLine()
        super().__init__(
            RtdeSession(settings),
            settings,
            self._rtde,
            mailbox,
            settings.cycle_s,
            real_time=real_time,
            locked=locked,
        )
        self._channel = channel
        channel.setblocking(False)
        self._rehearsal = Rehearsal()
        self._recipe = 0
        self._head = b""  # of the packages of our recipe
        self._last_data = b""  # the last package answered
        self._broken_off = False

    def close(self) -> None:
        """Close connection and channel."""
        self._rtde.detach()
        self._rehearsal.close()
        self._channel.close()

    def _step(self) -> None:
        session = self.session
        if session.has_line and session.phase is StreamPhase.IDLE:
            self._disconnect()
        if (data := self._receive()) is not None:
            self._serve(data)
            return
        if self._rtde.broken and not self._broken_off:
            self._broken_off = True
            session.break_off()
        self._check_orders()

    def _receive(self) -> bytes | None:
        """Return the controller's newest package, or None if none arrives in time."""
        data: bytes | None = self._receiver.next()
        if data is None:
            return None
        self._received_ns = self._receiver.received_ns
        is_late = self._received_ns - self._answered_ns >= self._late_ns
        if is_late:  # delayed packages arrive in a burst: only the last one is worth an answer
            time.sleep(BUNCH_S)
        if is_late or self._receiver.was_queued:
            data = self._newest(data)
        return data

    def _newest(self, data: bytes) -> bytes:
        try:
            while (newer := self._rtde.newer()) is not None:
                if is_output(newer, self._recipe):
                    self.session.dropped += 1
                    data = newer
        except OSError:
            pass  # the next reception tells
        return data

    def _serve(self, data: bytes) -> None:
        session = self.session
        ready = session.match(data, self._mailbox.stop_word()) if data.startswith(self._head) else None
        if ready is not None:
            self._send(ready.reply)
            self._last_data = data
            orders = self._mailbox.orders()
            session.advance_after_reply(OUTPUT.unpack_from(data), orders, self._received_ns)
            self._finish_cycle(data, session.device_clock, orders)
            return
        if not is_output(data, self._recipe):  # a message, or the reply to our start
            self._leave_unanswered(data)
            return
        orders = self._mailbox.orders()
        if (reply := session.answer(OUTPUT.unpack_from(data), orders, self._received_ns)) is None:
            self._leave_unanswered(data)
            return
        self._send(reply)
        if session.phase is StreamPhase.ARMED:  # the script has not used a set-point yet
            self._check_orders()
            return
        self._finish_cycle(data, session.device_clock, orders)

    def _rehearse(self) -> None:
        """Run the code path from package to reply without effect, to keep the caches warm."""
        if data := self._last_data:
            self._rehearsal.exchange(data)
            self.session.match(data, self._mailbox.stop_word())

    def _send(self, package: bytes) -> None:
        try:
            self._rtde.send(package)
        except OSError:
            self.session.rejected += 1
        self._note_sent(package)

    def _new_command(self, number: int) -> Command | None:
        command = super()._new_command(number)
        is_opened = command is not None and isinstance(command.request, OpenStream)
        if is_opened and self.session.phase is StreamPhase.IDLE:
            self._connect()
        return command

    def _connect(self) -> None:
        """Take over the connection given for this stream, and start its packages."""
        self._disconnect()
        if (given := take_connection(self._channel)) is None:
            return
        handover, connection = given
        self._mailbox.clear_histograms()
        self._rtde.attach(connection)
        self._recipe = handover.output_recipe
        self._head = HEAD.pack(OUTPUT.size, PackageType.DATA, self._recipe)
        self.session.adopt(handover.input_recipe, handover.run, handover.safety_mode)
        with contextlib.suppress(OSError):
            self._rtde.send(START_REQUEST)

    def _disconnect(self) -> None:
        self._rtde.detach()
        self.session.has_line = False
        self._broken_off = False
        self._processor.free()
