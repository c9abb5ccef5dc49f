"""The driver's side of the receiver process: starts it, gives it orders, fetches frames."""

from __future__ import annotations

import contextlib
import itertools
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable

from drivers.basler_stereo.errors import ReceiverEnded
from drivers.basler_stereo.stream.frame_assembler import Frame, StreamCounters
from drivers.basler_stereo.stream.frame_slots import NOTE_BYTES, FrameSlots
from drivers.basler_stereo.stream.receiver_orders import (
    CloseStream,
    EndKeepAlive,
    ExpectBlock,
    KeepAlive,
    OpenStream,
    Order,
    send_order,
)
from ronna_hw.host.process import children_uninterrupted, describe_exit

RECEIVER_MODULE = "drivers.basler_stereo.stream.receiver_process"
END_LIMIT_S = 2.0
LOOK_UP_S = 0.1  # while waiting for a frame: how quickly a hopeless wait is noticed


class ReceiverProcess:
    """One process for the streams of all cameras; it ends when `close` is called or its parent dies."""

    def __init__(self) -> None:
        self._orders, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._numbers = itertools.count(1)
        with theirs, children_uninterrupted():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", RECEIVER_MODULE, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                pass_fds=(theirs.fileno(),),
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def receive(
        self,
        stream: socket.socket,
        control: socket.socket,
        payload_bytes: int,
        packet_bytes: int,
        resend: bool,
    ) -> StreamReceiver:
        """Receive a stream; resend requests are sent on `control`. Raises GEV-017."""
        number = next(self._numbers)
        memory = FrameSlots.allocate(payload_bytes)
        try:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with theirs:
                order = OpenStream(number, payload_bytes, packet_bytes, resend)
                self.tell(order, stream.fileno(), control.fileno(), memory, theirs.fileno())
            return StreamReceiver(self, number, FrameSlots(memory, payload_bytes), ours)
        finally:
            os.close(memory)

    def keep_alive(self, control: socket.socket, period_s: float) -> int:
        """Send keep-alives to a camera; returns the number for ending them. Raises GEV-017."""
        number = next(self._numbers)
        self.tell(KeepAlive(number, period_s), control.fileno())
        return number

    def end_keep_alive(self, number: int) -> None:
        """Stop the keep-alives."""
        with contextlib.suppress(ReceiverEnded):
            self.tell(EndKeepAlive(number))

    def ended(self, got: OSError | None = None) -> ReceiverEnded:
        """The error for a process that no longer answers, with how it ended."""
        try:
            how = describe_exit(self._process.wait(LOOK_UP_S))  # its end follows that of its channels
        except subprocess.TimeoutExpired:
            how = str(got or "its channel is closed")
        return ReceiverEnded("the receiver process has ended", got=how)

    def close(self) -> None:
        """End the process, within two seconds."""
        self._orders.close()
        try:
            self._process.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def tell(self, order: Order, *descriptors: int) -> None:
        """Send it an order. Raises GEV-017."""
        try:
            send_order(self._orders, order, descriptors)
        except OSError as error:
            raise self.ended(error) from error


class StreamReceiver:
    """The frames of one stream, fetched from shared memory in the order of their completion."""

    def __init__(
        self, process: ReceiverProcess, number: int, slots: FrameSlots, notes: socket.socket
    ) -> None:
        self._process = process
        self._number = number
        self._slots = slots
        self._notes = notes

    @property
    def counters(self) -> StreamCounters:
        """Statistics since the stream was opened."""
        return self._slots.counters()

    @property
    def begun(self) -> bool:
        """Whether any image packet has arrived since the stream was opened."""
        counters = self.counters
        return counters.packets > counters.refusals

    def expect(self, block_id: int, patience_s: float) -> None:
        """A block was triggered; request it if it has not begun after `patience_s`."""
        self._process.tell(ExpectBlock(self._number, block_id, patience_s))

    def take(self, deadline_s: float, hopeless: Callable[[], bool] = lambda: False) -> Frame | None:
        """The oldest frame not yet taken, or None if there is none by the deadline (host monotonic).

        Also None as soon as `hopeless()`. Raises GEV-017.
        """
        while True:
            left_s = deadline_s - time.monotonic()
            # an available frame is taken even after the deadline
            if select.select([self._notes], [], [], max(0.0, min(left_s, LOOK_UP_S)))[0]:
                frame = self._slots.fetch(self._next_note())
                if frame is not None:
                    return frame
            elif left_s <= 0 or hopeless():
                return None

    def discard(self) -> None:
        """Discard frames not yet taken. Raises GEV-017."""
        while select.select([self._notes], [], [], 0.0)[0]:
            self._next_note()

    def close(self) -> None:
        """Stop receiving the stream."""
        with contextlib.suppress(ReceiverEnded):
            self._process.tell(CloseStream(self._number))
        self._notes.close()

    def _next_note(self) -> bytes:
        try:
            note = self._notes.recv(NOTE_BYTES)
        except OSError as error:
            raise self._process.ended(error) from error
        if not note:
            raise self._process.ended()
        return note
