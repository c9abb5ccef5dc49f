"""Driver side of stream reception: socket, packet size and receiver process."""

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

from drivers.basler_stereo.control_channel import CameraControl
from drivers.basler_stereo.errors import PACKET_TOO_LARGE, ReceiverEnded
from drivers.basler_stereo.gvcp import LARGEST_DATAGRAM_BYTES
from drivers.basler_stereo.options import SMALLEST_PACKET_BYTES
from drivers.basler_stereo.stream.frame_assembler import ReceivedImage, StreamCounters
from drivers.basler_stereo.stream.receiver_interface import (
    NOTE_BYTES,
    CloseImageStream,
    EndKeepAlive,
    ExpectBlock,
    FrameSlots,
    KeepAlive,
    OpenImageStream,
    Order,
    send_order,
)
from ronna_hw.host.process import describe_exit, shield_children
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap

RECEIVER_MODULE = "drivers.basler_stereo.stream.receiver_process"
END_LIMIT_S = 2.0
POLL_S = 0.1  # while waiting for a frame: how quickly a lost camera is noticed
SO_RCVBUFFORCE = 33  # from asm-generic/socket.h; not in Python's socket module
# largest first: jumbo frames of the camera family, ordinary Ethernet, and what every path carries
CANDIDATES_BYTES = (8192, 4000, 1500, SMALLEST_PACKET_BYTES)
DEFAULT_BYTES = 1500  # for a device that sends no test packets: any Ethernet carries it
PROBE_LIMIT_S = 0.1
PROBES = 2  # per size: one may be lost by chance


class ReceiverProcess:
    """Receiver process for all camera streams; ends on `close` or when its parent dies."""

    def __init__(self) -> None:
        self._orders, child_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._numbers = itertools.count(1)
        with child_end, shield_children():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", RECEIVER_MODULE, str(child_end.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                pass_fds=(child_end.fileno(),),
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
        """Start receiving a stream and sending resend requests on `control`; raises GEV-017."""
        number = next(self._numbers)
        memory = FrameSlots.allocate(payload_bytes)
        try:
            parent_end, child_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with child_end:
                order = OpenImageStream(number, payload_bytes, packet_bytes, resend)
                self.give_order(order, stream.fileno(), control.fileno(), memory, child_end.fileno())
            return StreamReceiver(self, number, FrameSlots(memory, payload_bytes), parent_end)
        finally:
            os.close(memory)

    def keep_alive(self, control: socket.socket, period_s: float) -> int:
        """Send keep-alives to a camera; returns a number for `end_keep_alive`. Raises GEV-017."""
        number = next(self._numbers)
        self.give_order(KeepAlive(number, period_s), control.fileno())
        return number

    def end_keep_alive(self, number: int) -> None:
        """Stop the keep-alives."""
        with contextlib.suppress(ReceiverEnded):
            self.give_order(EndKeepAlive(number))

    def ended_error(self, got: OSError | None = None) -> ReceiverEnded:
        """Build the error for a terminated receiver process, with its exit status."""
        try:
            exit_text = describe_exit(self._process.wait(POLL_S))  # it ends shortly after its channels
        except subprocess.TimeoutExpired:
            exit_text = str(got or "its channel is closed")
        return ReceiverEnded("the receiver process has ended", got=exit_text)

    def close(self) -> None:
        """End the process within two seconds."""
        self._orders.close()
        try:
            self._process.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def give_order(self, order: Order, *descriptors: int) -> None:
        """Send an order to the process; raises GEV-017."""
        try:
            send_order(self._orders, order, descriptors)
        except OSError as error:
            raise self.ended_error(error) from error


class StreamReceiver:
    """Receiver for one stream's frames, in order of completion."""

    def __init__(
        self, process: ReceiverProcess, number: int, slots: FrameSlots, notes: socket.socket
    ) -> None:
        self._process = process
        self._number = number
        self._slots = slots
        self._notes = notes

    @property
    def counters(self) -> StreamCounters:
        """Stream statistics since opening."""
        return self._slots.counters()

    @property
    def has_begun(self) -> bool:
        """Whether any image packet has arrived since opening."""
        counters = self.counters
        return counters.packets > counters.refusals

    def expect(self, block_id: int, patience_s: float) -> None:
        """Expect a triggered block and request it if none of it arrives within `patience_s`."""
        self._process.give_order(ExpectBlock(self._number, block_id, patience_s))

    def take(self, deadline_s: float, give_up: Callable[[], bool] = lambda: False) -> ReceivedImage | None:
        """Return the oldest pending frame, or None at the deadline (host monotonic time).

        Also None as soon as `give_up()`. Raises GEV-017.
        """
        while True:
            remaining_s = deadline_s - time.monotonic()
            # an available frame is taken even after the deadline
            if select.select([self._notes], [], [], max(0.0, min(remaining_s, POLL_S)))[0]:
                if (frame := self._slots.fetch(self._next_note())) is not None:
                    return frame
            elif remaining_s <= 0 or give_up():
                return None

    def discard(self) -> None:
        """Discard pending frames; raises GEV-017."""
        while select.select([self._notes], [], [], 0.0)[0]:
            self._next_note()

    def close(self) -> None:
        """Stop receiving the stream."""
        with contextlib.suppress(ReceiverEnded):
            self._process.give_order(CloseImageStream(self._number))
        self._notes.close()

    def _next_note(self) -> bytes:
        try:
            note = self._notes.recv(NOTE_BYTES)
        except OSError as error:
            raise self._process.ended_error(error) from error
        if not note:
            raise self._process.ended_error()
        return note


def open_stream_socket(local_address: str, receive_buffer_bytes: int) -> socket.socket:
    """Open a stream socket on a free port of the host address."""
    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    # The kernel caps the size at net.core.rmem_max, except for the superuser; packets that do not fit are
    # lost and requested again.
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
    with contextlib.suppress(OSError):
        stream.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, receive_buffer_bytes)
    stream.bind((local_address, 0))
    return stream


def await_packet(stream: socket.socket, sender: str, packet_bytes: int, limit_s: float) -> bool:
    """Return whether a packet of this size arrives from the sender in time; discards all others."""
    deadline_s = time.monotonic() + limit_s
    # a datagram that is already there counts even if the host stalled beyond the limit
    while select.select([stream], [], [], max(0.0, deadline_s - time.monotonic()))[0]:
        datagram, (host, _) = stream.recvfrom(LARGEST_DATAGRAM_BYTES)
        if host == sender and len(datagram) == packet_bytes - gev.IP_UDP_HEADER_BYTES:
            return True
    return False


def choose_packet_bytes(
    control: CameraControl, stream: socket.socket, wanted_bytes: int | None, deadline_s: float
) -> tuple[int, bool]:
    """Choose and set the packet size; returns whether a test packet confirmed it.

    Uses the largest candidate that arrives, or checks the wanted size. For a device that sends
    no test packets, the wanted or the default size is used. Raises GEV-012 when only sizes below
    the wanted one arrive.
    """
    point_stream_to(control, stream, deadline_s)
    try:
        for size in (wanted_bytes,) if wanted_bytes else CANDIDATES_BYTES:
            if _test_size(control, stream, size, deadline_s):
                return _set_packet_bytes(control, size, deadline_s), True
        for size in CANDIDATES_BYTES if wanted_bytes else ():
            if size < (wanted_bytes or 0) and _test_size(control, stream, size, deadline_s):
                raise PACKET_TOO_LARGE(
                    f"packets of {wanted_bytes} bytes from {control.address} do not arrive",
                    expected=f"a test packet within {PROBE_LIMIT_S} s",
                    limit=f"{size} bytes, which do arrive",
                )
        return _set_packet_bytes(control, wanted_bytes or DEFAULT_BYTES, deadline_s), False
    finally:
        control.write_register(Bootstrap.SCP, 0, deadline_s)


def point_stream_to(control: CameraControl, stream: socket.socket, deadline_s: float) -> None:
    """Set the camera's stream destination."""
    host, port = stream.getsockname()
    address = int.from_bytes(socket.inet_aton(host), "big")
    control.write_register(Bootstrap.SCDA, address, deadline_s)
    control.write_register(Bootstrap.SCP, port & gev.SCP_PORT_MASK, deadline_s)


def _test_size(control: CameraControl, stream: socket.socket, size: int, deadline_s: float) -> bool:
    probe_value = size | gev.SCPS_FIRE_TEST | gev.SCPS_DO_NOT_FRAGMENT
    for _ in range(PROBES):
        control.write_register(Bootstrap.SCPS, probe_value, deadline_s)
        if await_packet(stream, control.peer_address, size, PROBE_LIMIT_S):
            return True
    return False


def _set_packet_bytes(control: CameraControl, size: int, deadline_s: float) -> int:
    """Set the packet size; return the size that the camera accepted."""
    control.write_register(Bootstrap.SCPS, size | gev.SCPS_DO_NOT_FRAGMENT, deadline_s)
    return control.read_register(Bootstrap.SCPS, deadline_s) & gev.SCPS_SIZE_MASK
