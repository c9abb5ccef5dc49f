"""Reading from a client's non-blocking socket."""

from __future__ import annotations

import socket

READ_BYTES = 65536


def receive_waiting(client: socket.socket) -> bytes | None:
    """Return the bytes that have arrived, none once the client is gone, and None while none are waiting."""
    try:
        return client.recv(READ_BYTES)
    except BlockingIOError:
        return None
    except OSError:
        return b""
