"""Receives one camera's stream in a thread of its own and hands out whole frames."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable

from drivers.basler_stereo.assembly import Frame, FrameAssembler, StreamCounters
from ronna_hw.wire import gige_vision as gev

DATAGRAM_LIMIT_BYTES = 65_536
IDLE_WAIT_S = 0.5  # between looks at whether to end, while no frame has begun
FRAME_WAIT_S = 0.01  # while one has: how soon a pause is noticed
KEPT_FRAMES = 8  # nobody fetched more than that: the oldest go
JOIN_LIMIT_S = 1.0

RequestResend = Callable[[int, int, int], None]


def open_stream_socket(local_address: str, receive_buffer_bytes: int) -> socket.socket:
    """A socket for the stream on a free port of the host's address."""
    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    # The kernel caps the size at net.core.rmem_max; what does not fit is lost and asked for again.
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
    stream.bind((local_address, 0))
    return stream


def probe_arrives(stream: socket.socket, packet_bytes: int, limit_s: float) -> bool:
    """True when a datagram with that packet size comes within the limit; others are thrown away."""
    deadline_s = time.monotonic() + limit_s
    while (left_s := deadline_s - time.monotonic()) > 0:
        if not select.select([stream], [], [], left_s)[0]:
            return False
        if len(stream.recv(DATAGRAM_LIMIT_BYTES)) == packet_bytes - gev.IP_UDP_HEADER_BYTES:
            return True
    return False


class StreamReceiver:
    """Owns the stream's socket and its thread; `request_resend` asks the camera for packets."""

    def __init__(
        self,
        stream: socket.socket,
        assembler: FrameAssembler,
        request_resend: RequestResend | None,
        name: str,
    ) -> None:
        self._socket = stream
        self._assembler = assembler
        self._request_resend = request_resend
        self._frames: deque[Frame] = deque(maxlen=KEPT_FRAMES)
        self._changed = threading.Condition()
        self._ending = False
        self._thread = threading.Thread(target=self._run, name=f"{name}-stream", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where the camera has to send."""
        return int(self._socket.getsockname()[1])

    @property
    def counters(self) -> StreamCounters:
        """What happened since the stream was opened."""
        return self._assembler.counters

    @property
    def begun(self) -> bool:
        """True when any packet came since the stream was opened."""
        return self._assembler.counters.packets > 0

    def take(self, deadline_s: float) -> Frame | None:
        """The oldest frame not yet taken, or None when none is there by the deadline (host monotonic)."""
        with self._changed:
            while not self._frames:
                left_s = deadline_s - time.monotonic()
                if left_s <= 0 or self._ending or not self._changed.wait(left_s):
                    break
            return self._frames.popleft() if self._frames else None

    def discard(self) -> int:
        """Throw away the frames that nobody took; returns how many."""
        with self._changed:
            count = len(self._frames)
            self._frames.clear()
            return count

    def close(self) -> None:
        """End the thread and the socket, within a second."""
        self._ending = True
        with contextlib.suppress(OSError):  # an empty datagram wakes the thread
            self._socket.sendto(b"", self._socket.getsockname())
        self._thread.join(JOIN_LIMIT_S)
        self._socket.close()

    def _run(self) -> None:
        buffer = bytearray(DATAGRAM_LIMIT_BYTES)
        view = memoryview(buffer)
        wait_s = 0.0
        while not self._ending:
            wanted_s = FRAME_WAIT_S if self._assembler.waiting else IDLE_WAIT_S
            if wanted_s != wait_s:
                wait_s = wanted_s
                _set_receive_limit(self._socket, wait_s)
            frame = None
            try:
                size = self._socket.recv_into(buffer)
                frame = self._assembler.accept(view[:size], time.monotonic())
            except BlockingIOError:  # nothing came within the limit
                pass
            except OSError:
                break  # the socket is closed
            if frame is not None:
                self._hand_out(frame)
            if self._assembler.waiting:
                self._chase()

    def _chase(self) -> None:
        ranges, given_up = self._assembler.overdue(time.monotonic())
        if self._request_resend is not None:
            for block_id, first, last in ranges:
                self._request_resend(block_id, first, last)
        if given_up is not None:
            self._hand_out(given_up)

    def _hand_out(self, frame: Frame) -> None:
        with self._changed:
            self._frames.append(frame)
            self._changed.notify_all()


def _set_receive_limit(stream: socket.socket, limit_s: float) -> None:
    """The kernel's own time limit: one system call per packet, where Python's would take two."""
    seconds, rest_s = divmod(limit_s, 1.0)
    stream.setsockopt(
        socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", int(seconds), round(rest_s * 1e6))
    )
