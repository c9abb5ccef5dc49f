"""Link sockets: one that listens for any controller, one connected to the stream's."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import termios
from fcntl import ioctl

from drivers.kuka_rsi.realtime.telegram import LONGEST_TELEGRAM
from ronna_hw.arm_stream.pace import limit_receiving

ANY_HOST = "0.0.0.0"
Address = tuple[str, int]
Received = tuple[bytes, Address]
_NO_BYTES = struct.pack("i", 0)


def bind(host: str, port: int) -> socket.socket:
    """Open the receiving socket without address reuse; a second listener would steal telegrams."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.bind((host, port))
    except OSError:
        link.close()
        raise
    limit_receiving(link)
    return link


class LinkSockets:
    """Unconnected link socket, plus one connected to the controller during a stream.

    A connected socket receives only what its peer sends: no foreign datagram gets between a telegram and its
    reply. The kernel also records which processor received the last one.
    """

    def __init__(self, listening: socket.socket) -> None:
        self._listening = listening
        self._line = listening  # the socket that telegrams arrive on now
        self._peer: Address | None = None  # only while the stream has its own socket

    @property
    def is_connected(self) -> bool:
        """Whether only the stream's controller is received."""
        return self._peer is not None

    def connect_to(self, peer: Address) -> None:
        """Open the stream socket connected to this controller."""
        self.disconnect()
        own: Address = self._listening.getsockname()
        if own[0] == ANY_HOST:
            return  # the controller may send to another of our addresses than the kernel would choose
        line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # Both must permit it now, and neither afterwards: no one else can bind.
        try:
            for each in (self._listening, line):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            line.bind(own)
            line.connect(peer)
            limit_receiving(line)
        except OSError:
            line.close()
        else:
            line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
            self._line, self._peer = line, peer
        finally:
            self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)

    def disconnect(self) -> None:
        """Close the stream socket, so that any sender is received again."""
        if self._peer is not None:
            self._line.close()
            self._line, self._peer = self._listening, None

    def receive(self, flags: int = 0) -> Received:
        """Receive a datagram; raises OSError on time-out or if a reply was refused."""
        if self._peer is not None:  # cheaper than receiving the address each time
            return self._line.recv(LONGEST_TELEGRAM, flags), self._peer
        received: Received = self._line.recvfrom(LONGEST_TELEGRAM, flags)
        return received

    def send(self, reply: bytes, address: Address) -> None:
        """Send a reply; raises OSError."""
        if self._peer is not None:
            self._line.send(reply)
        else:
            self._line.sendto(reply, address)

    def sleep(self, limit_s: float) -> bool:
        """Sleep until a datagram arrives; returns False on time-out."""
        return bool(select.select((self._line,), (), (), limit_s)[0])

    def has_datagram(self) -> bool:
        """Return whether a datagram is pending, without the cost of an exception."""
        return ioctl(self._line, termios.FIONREAD, _NO_BYTES) != _NO_BYTES

    def foreign_sender(self) -> Address | None:
        """Discard a datagram from outside the stream and return its sender, if there is one."""
        if self._peer is None or ioctl(self._listening, termios.FIONREAD, _NO_BYTES) == _NO_BYTES:
            return None
        try:
            address: Address = self._listening.recvfrom(1, socket.MSG_DONTWAIT)[1]
        except OSError:
            return None
        return address

    def processor(self) -> int:
        """Return the processor that received the last telegram, or -1 if unknown."""
        return self._line.getsockopt(socket.SOL_SOCKET, socket.SO_INCOMING_CPU) if self._peer else -1


class Rehearsal:
    """Dry run of sending and receiving on a loopback socket connected to itself."""

    def __init__(self) -> None:
        self._own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._own.bind(("127.0.0.1", 0))
        self._own.connect(self._own.getsockname())

    def exchange(self, data: bytes) -> None:
        """Send and receive a datagram through the same calls as a real exchange."""
        with contextlib.suppress(OSError):  # nothing depends on it
            self._own.send(data)
            self._own.recv(LONGEST_TELEGRAM, socket.MSG_DONTWAIT)

    def close(self) -> None:
        """Close the socket."""
        self._own.close()
