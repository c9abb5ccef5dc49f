"""RTDE connection of the real-time process: complete packages out of a stream of bytes."""

from __future__ import annotations

import select
import socket
import struct
import termios
import time
from fcntl import ioctl
from typing import Final

from drivers.universal_robots.realtime.packages import HEADER, OUTPUT
from ronna_hw.arm_stream.pace import IDLE_POLL_S, limit_receiving
from ronna_hw.wire.universal_robots import RTDE_HEADER_BYTES

CAPACITY_BYTES: Final = 1 << 16  # half a second of packages at 500 Hz
LONGEST_PACKAGE_BYTES: Final = 4096  # a message; data packages have below 200 bytes
CONNECT_LIMIT_S: Final = 0.1  # to oneself
_SIZE: Final = struct.Struct(">H")
_OUTPUT_SIZE: Final = _SIZE.pack(OUTPUT.size)
_AT_ONCE: Final = int(socket.MSG_DONTWAIT)  # a plain number costs less than the flag
_NO_BYTES: Final = struct.pack("i", 0)


class RtdeLine:
    """Connection to a controller, or none. `broken` says in words why it ended; its bytes may still be read.

    Packages are received into one buffer, which is emptied as a whole in a controller's usual pace.
    """

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        self._buffer = bytearray(CAPACITY_BYTES)
        self._view = memoryview(self._buffer)
        self._begin = self._end = 0
        self.broken = ""

    @property
    def is_connected(self) -> bool:
        """Whether a controller is connected."""
        return self._socket is not None

    def attach(self, connection: socket.socket) -> None:
        """Receive from this connection, whose replies to setup requests have been read."""
        self.detach()
        connection.setblocking(True)
        limit_receiving(connection)
        self._socket = connection

    def detach(self) -> None:
        """Close the connection: the controller frees its input registers."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._begin = self._end = 0
        self.broken = ""

    def has_datagram(self) -> bool:
        """Return whether bytes are pending."""
        if self._socket is None:
            return False
        return self._begin != self._end or ioctl(self._socket, termios.FIONREAD, _NO_BYTES) != _NO_BYTES

    def sleep(self, limit_s: float) -> bool:
        """Sleep until bytes arrive; returns False on time-out."""
        return bool(select.select((self._socket,), (), (), limit_s)[0]) if self._socket else False

    def receive(self) -> bytes:
        """Receive the next package; raises OSError on time-out or when the connection is broken."""
        if (line := self._socket) is None or self.broken:
            time.sleep(IDLE_POLL_S)
            raise BlockingIOError
        while True:
            package = self._next_package() if self._end else None
            if package is not None:
                return package
            try:
                count = line.recv_into(self._view[self._end :] if self._end else self._buffer)
            except ConnectionError as error:
                self.broken = f"the connection broke ({(error.strerror or str(error)).lower()})"
                raise
            if not count:
                self.broken = "the controller closed the connection"
                raise ConnectionResetError
            if count == OUTPUT.size and not self._end and self._buffer.startswith(_OUTPUT_SIZE):
                return bytes(self._view[:count])  # as usual: one of our packages, and nothing else
            self._end += count

    def newer(self) -> bytes | None:
        """Return a package that has arrived behind the last one, without waiting."""
        if self._socket is None or self.broken:
            return None
        package = self._next_package()
        if package is None and ioctl(self._socket, termios.FIONREAD, _NO_BYTES) != _NO_BYTES:
            count = self._socket.recv_into(self._view[self._end :])
            self._end += count
            package = self._next_package()
        return package

    def send(self, package: bytes) -> None:
        """Send a package without waiting; raises OSError, also when only a part could be sent."""
        if self._socket is None:
            raise ConnectionResetError
        sent = self._socket.send(package, _AT_ONCE)
        if sent != len(package):  # what follows would be misread
            self.broken = "the controller does not read our set-points"
            raise BlockingIOError

    def processor(self) -> int:
        """Return the processor that received the last package, or -1 if unknown."""
        return self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_INCOMING_CPU) if self._socket else -1

    def _next_package(self) -> bytes | None:
        """Take the next complete package out of the buffer; raises OSError if there can be none."""
        begin, end = self._begin, self._end
        if end - begin < RTDE_HEADER_BYTES:
            self._make_room(begin, end)
            return None
        size: int = _SIZE.unpack_from(self._buffer, begin)[0]
        if size < RTDE_HEADER_BYTES or size > LONGEST_PACKAGE_BYTES:
            self.broken = f"a package of {size} bytes, which none has"
            raise ConnectionAbortedError
        if end - begin < size:
            self._make_room(begin, end)
            return None
        package = bytes(self._view[begin : begin + size])
        begin += size
        self._begin, self._end = (0, 0) if begin == end else (begin, end)
        return package

    def _make_room(self, begin: int, end: int) -> None:
        """Move an incomplete package to the front when the buffer ends behind it."""
        if CAPACITY_BYTES - end < LONGEST_PACKAGE_BYTES:
            part = bytes(self._view[begin:end])
            self._buffer[: len(part)] = part
            self._begin, self._end = 0, len(part)


class Rehearsal:
    """Dry run of sending and receiving, on a connection of a socket with itself."""

    def __init__(self) -> None:
        self._line = RtdeLine()
        own = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            own.settimeout(CONNECT_LIMIT_S)
            own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            own.bind(("127.0.0.1", 0))
            own.connect(own.getsockname())  # both ends at once: nothing listens
            self._line.attach(own)
        except OSError:  # nothing depends on it
            own.close()

    @property
    def line(self) -> RtdeLine:
        """Connection with itself, or none."""
        return self._line

    def exchange(self, package: bytes) -> None:
        """Send and receive a package through the same calls as a real exchange; never waits."""
        line = self._line
        try:
            line.send(package)
            if line.has_datagram():
                line.receive()
        except OSError:
            line.detach()

    def close(self) -> None:
        """Close the connection."""
        self._line.detach()


def is_output(package: bytes, recipe: int) -> bool:
    """Return whether a package is a data package of our recipe; a longer one begins with it."""
    if len(package) < OUTPUT.size:
        return False
    _, kind = HEADER.unpack_from(package)
    return kind == ord("U") and package[RTDE_HEADER_BYTES] == recipe
