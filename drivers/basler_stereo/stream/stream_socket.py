"""The socket that receives a camera's stream."""

from __future__ import annotations

import contextlib
import select
import socket
import time

from ronna_hw.wire import gige_vision as gev

DATAGRAM_LIMIT_BYTES = 65_536
SO_RCVBUFFORCE = 33  # from asm-generic/socket.h; not in Python's socket module


def open_stream_socket(local_address: str, receive_buffer_bytes: int) -> socket.socket:
    """A socket for the stream on a free port of the host's address."""
    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    # The kernel caps the size at net.core.rmem_max, except for the superuser; packets that do not fit are
    # lost and requested again.
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
    with contextlib.suppress(OSError):
        stream.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, receive_buffer_bytes)
    stream.bind((local_address, 0))
    return stream


def probe_arrives(stream: socket.socket, sender: str, packet_bytes: int, limit_s: float) -> bool:
    """Whether a datagram of this packet size arrives from the sender within the limit; others are dropped."""
    deadline_s = time.monotonic() + limit_s
    # a datagram that is already there counts even if the host stalled beyond the limit
    while select.select([stream], [], [], max(0.0, deadline_s - time.monotonic()))[0]:
        datagram, (host, _) = stream.recvfrom(DATAGRAM_LIMIT_BYTES)
        if host == sender and len(datagram) == packet_bytes - gev.IP_UDP_HEADER_BYTES:
            return True
    return False
