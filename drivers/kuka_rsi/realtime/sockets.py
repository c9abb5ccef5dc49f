"""The sockets of one link: an unconnected one, and during a stream one connected to its controller.

A connected socket receives only what its peer sends: no foreign datagram gets between a telegram and its
reply. The kernel also records which processor received the last one.
"""

from __future__ import annotations

import select
import socket
import struct
import termios
from fcntl import ioctl

from drivers.kuka_rsi.realtime.telegram import LONGEST_TELEGRAM

IDLE_LOOK_S = 0.01  # longest wait for a telegram between checks of orders, silence and parent
ANY_HOST = "0.0.0.0"
_NO_BYTES = struct.pack("i", 0)
_TIMEVAL = struct.Struct("ll")

Address = tuple[str, int]
Received = tuple[bytes, Address]


def bind(host: str, port: int) -> socket.socket:
    """The socket that the controller sends to. No address reuse: a second listener would take telegrams."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.bind((host, port))
    except OSError:
        link.close()
        raise
    _limit_waiting(link)
    return link


class LinkSockets:
    """Telegrams arrive on the stream's socket between `meet` and `part`."""

    def __init__(self, listening: socket.socket) -> None:
        self._listening = listening
        self._line = listening  # the socket that telegrams arrive on now
        self._peer: Address | None = None  # only while the stream has its own socket

    def meet(self, peer: Address) -> None:
        """A stream with this controller begins."""
        self.part()
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
            _limit_waiting(line)
        except OSError:
            line.close()
        else:
            line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
            self._line, self._peer = line, peer
        finally:
            self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)

    def part(self) -> None:
        """The stream is over: a telegram may come from anywhere again."""
        if self._peer is not None:
            self._line.close()
            self._line, self._peer = self._listening, None

    def receive(self, flags: int = 0) -> Received:
        """The next datagram; raises OSError if none arrived for a while, or the network refused a reply."""
        if self._peer is not None:  # cheaper than receiving the address each time
            return self._line.recv(LONGEST_TELEGRAM, flags), self._peer
        received: Received = self._line.recvfrom(LONGEST_TELEGRAM, flags)
        return received

    def send(self, reply: bytes, address: Address) -> None:
        """One reply; raises OSError."""
        if self._peer is not None:
            self._line.send(reply)
        else:
            self._line.sendto(reply, address)

    def sleep(self, limit_s: float) -> bool:
        """Wait for a datagram; False if none arrived in time."""
        return bool(select.select((self._line,), (), (), limit_s)[0])

    def something_there(self) -> bool:
        """Whether a datagram is waiting. Cheaper than the exception of an empty socket."""
        return ioctl(self._line, termios.FIONREAD, _NO_BYTES) != _NO_BYTES

    def stranger(self) -> Address | None:
        """Sender of the next datagram that is not the stream's; None if there is none."""
        if self._peer is None or ioctl(self._listening, termios.FIONREAD, _NO_BYTES) == _NO_BYTES:
            return None
        try:
            address: Address = self._listening.recvfrom(1, socket.MSG_DONTWAIT)[1]
        except OSError:
            return None
        return address

    def processor(self) -> int:
        """Number of the processor that received the last telegram; -1 when unknown."""
        return self._line.getsockopt(socket.SOL_SOCKET, socket.SO_INCOMING_CPU) if self._peer else -1


def _limit_waiting(link: socket.socket) -> None:
    seconds, rest = divmod(IDLE_LOOK_S, 1.0)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(int(seconds), int(rest * 1e6)))
