"""Receiver process for both streams: `python -P -m drivers.basler_stereo.stream.receiver_process FD`.

The driver starts it, so that a stalled driver loses no packets. The channel FD carries orders; when it
closes, the driver is gone. Ctrl-C never reaches it: the driver starts it in a session of its own with
SIGINT blocked.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import socket
import sys
import time

from drivers.basler_stereo import gvcp
from drivers.basler_stereo.stream.frame_assembler import FrameAssembler, ReceivedImage
from drivers.basler_stereo.stream.receiver_interface import (
    CloseImageStream,
    EndKeepAlive,
    ExpectBlock,
    FrameSlots,
    KeepAlive,
    OpenImageStream,
    Order,
    receive_order,
)
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GvcpCommand, GvcpFlag

FRAME_WAIT_S = 0.004  # while a frame is incomplete: how quickly a pause is noticed
IDLE_WAIT_S = 1.0
PACKETS_AT_ONCE = 64  # of one stream before the other's turn
# Packets are collected for a moment: waking up for each burst costs as much as reading it, and on a busy
# computer every wake-up has to wait.
GATHER_S = 0.002
GATHER_BUFFER_BYTES = 2 << 20  # in the kernel's units; a 1 Gbit/s link fills a quarter of it in that time
EXIT_NOT_STARTED = 2
NICENESS = -10  # the socket buffers less than a tenth of a second of packets


class _Stream:
    """One camera's stream: socket, assembler, shared memory and note channel."""

    def __init__(self, order: OpenImageStream, descriptors: list[int]) -> None:
        stream, control, memory, notes = descriptors
        self.socket = socket.socket(fileno=stream)
        self.socket.setblocking(False)
        self._control = socket.socket(fileno=control)
        self._camera_address = self._control.getpeername()[0]
        self._notes = socket.socket(fileno=notes)
        self._notes.setblocking(False)
        self._slots = FrameSlots(memory, order.payload_bytes)
        os.close(memory)
        self._may_gather = self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= GATHER_BUFFER_BYTES
        self._resend = order.resend
        self._assembler = FrameAssembler(order.payload_bytes, order.packet_bytes, self._slots.claim)
        self._request_id = 0

    @property
    def is_waiting(self) -> bool:
        return self._assembler.is_waiting

    @property
    def should_gather(self) -> bool:
        """Whether packets may briefly accumulate in the socket."""
        return self._may_gather and self._assembler.is_waiting

    def expect(self, block_id: int, from_s: float) -> None:
        self._assembler.expect(block_id, from_s)

    def receive(self, buffer: bytearray, view: memoryview) -> bool:
        """Process a limited number of arrived packets; returns whether there may be more."""
        accept, receive = self._assembler.accept, self.socket.recvfrom_into
        now_s = time.monotonic()
        with contextlib.suppress(OSError):  # nothing more has arrived
            for _ in range(PACKETS_AT_ONCE):
                size, (sender, _) = receive(buffer)
                if sender != self._camera_address:
                    self._assembler.counters.foreign += 1
                    continue
                if (frame := accept(view[:size], now_s)) is not None:
                    self._announce(frame)
            return True
        self._slots.write_counters(self._assembler.counters)
        return False

    def request_missing(self, now_s: float) -> None:
        """Request missing packets, and give up frames that remain incomplete."""
        ranges, abandoned = self._assembler.find_overdue(now_s)
        if self._resend:
            for block_id, first, last in ranges:
                self._request_id = self._request_id % gev.REQUEST_ID_LAST + gev.REQUEST_ID_FIRST
                with contextlib.suppress(OSError):
                    self._control.send(gvcp.encode_resend(self._request_id, block_id, first, last))
        if abandoned is not None:
            self._announce(abandoned)
        if ranges or abandoned is not None:
            self._slots.write_counters(self._assembler.counters)

    def close(self) -> None:
        for each in (self.socket, self._control, self._notes):
            each.close()

    def _announce(self, frame: ReceivedImage) -> None:
        self._slots.write_counters(self._assembler.counters)
        with contextlib.suppress(OSError):  # the driver does not fetch: newer frames reuse the slots
            self._notes.send(self._slots.note(frame))


class _KeepAlive:
    """Keep-alive sender for one camera.

    They request no acknowledge: the driver's own heartbeat checks who is in control. They continue while the
    driver is busy or gets no CPU time.
    """

    def __init__(self, period_s: float, control: int) -> None:
        self._period_s = period_s
        self._control = socket.socket(fileno=control)
        self._command = gvcp.encode(
            GvcpCommand.READREG,
            gev.REQUEST_ID_LAST,  # reserved by the driver for this process
            gvcp.read_register_command(Bootstrap.CCP),
            GvcpFlag(0),
        )
        self.due_s = 0.0

    def send_when_due(self, now_s: float) -> None:
        if now_s >= self.due_s:
            self.due_s = now_s + self._period_s
            with contextlib.suppress(OSError):
                self._control.send(self._command)

    def close(self) -> None:
        self._control.close()


class ReceiverLoop:
    """Main loop of the receiver process: packets, orders and keep-alives."""

    def __init__(self, orders: socket.socket) -> None:
        self._orders = orders
        self._streams: dict[int, _Stream] = {}
        self._keep_alives: dict[int, _KeepAlive] = {}
        self._poll = select.poll()
        self._poll.register(orders, select.POLLIN)
        self._by_descriptor: dict[int, _Stream] = {}

    def run(self) -> None:
        """Run until the driver closes the order channel."""
        buffer = bytearray(gvcp.LARGEST_DATAGRAM_BYTES)
        view = memoryview(buffer)
        while True:
            has_more = False
            for descriptor, _ in self._poll.poll(self._poll_limit_s() * 1e3):
                if (stream := self._by_descriptor.get(descriptor)) is not None:
                    has_more |= stream.receive(buffer, view)
                elif descriptor == self._orders.fileno() and not self._take_order():
                    return
            now_s = time.monotonic()
            for stream in self._streams.values():
                if stream.is_waiting:
                    stream.request_missing(now_s)
            for keep_alive in self._keep_alives.values():
                keep_alive.send_when_due(now_s)
            if not has_more and any(stream.should_gather for stream in self._streams.values()):
                time.sleep(GATHER_S)

    def _poll_limit_s(self) -> float:
        if any(stream.is_waiting for stream in self._streams.values()):
            return FRAME_WAIT_S
        waits_s = [keep_alive.due_s - time.monotonic() for keep_alive in self._keep_alives.values()]
        return max(0.0, min([IDLE_WAIT_S, *waits_s]))

    def _take_order(self) -> bool:
        received = None
        with contextlib.suppress(OSError):
            received = receive_order(self._orders)
        if received is not None:
            self._execute(*received)
        return received is not None

    def _execute(self, order: Order, descriptors: list[int]) -> None:
        match order:
            case OpenImageStream():
                stream = _Stream(order, descriptors)
                self._streams[order.stream] = stream
                self._by_descriptor[stream.socket.fileno()] = stream
                self._poll.register(stream.socket, select.POLLIN)
            case CloseImageStream():
                if (closed_stream := self._streams.pop(order.stream, None)) is not None:
                    self._poll.unregister(closed_stream.socket)
                    del self._by_descriptor[closed_stream.socket.fileno()]
                    closed_stream.close()
            case ExpectBlock():
                if (expectant := self._streams.get(order.stream)) is not None:
                    expectant.expect(order.block_id, time.monotonic() + order.patience_s)
            case KeepAlive():
                self._keep_alives[order.camera] = _KeepAlive(order.period_s, descriptors[0])
            case EndKeepAlive():
                if (keep_alive := self._keep_alives.pop(order.camera, None)) is not None:
                    keep_alive.close()


def main(arguments: list[str]) -> int:
    """Run the receiver loop; returns 2 if not started by the driver."""
    try:
        orders = socket.socket(fileno=int(arguments[0]))
    except (IndexError, ValueError, OSError) as error:
        print(f"this process is started by the driver only: {error}", file=sys.stderr)  # noqa: T201
        return EXIT_NOT_STARTED
    with contextlib.suppress(OSError):  # superuser only; otherwise a busy computer loses more packets
        os.nice(NICENESS)
    gc.freeze()
    ReceiverLoop(orders).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
