"""Listening sockets of the console: on loopback, and at a separate address for remote viewers."""

from __future__ import annotations

import socket

import uvicorn

from console.errors import PortTaken
from console.guard import LARGEST_BODY_BYTES, Guard
from ronna_hw.command_line.viewers_address import ViewersAddress

HOST = "127.0.0.1"
BACKLOG = 64
SOCKET_BYTES = 4 * LARGEST_BODY_BYTES  # the page library sends some messages of its own


def listen(address: str, port: int, family: socket.AddressFamily = socket.AF_INET) -> socket.socket:
    """A listening socket; port 0 is any free one. Raises CON-001."""
    # The loop recognises TCP by the protocol and then disables Nagle's delay, which can hold
    # an answer for 40 ms.
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((address, port))
    except OSError as error:
        listening.close()
        raise PortTaken(f"port {port} of {address} cannot be used: {error.strerror}") from error
    listening.listen(BACKLOG)
    return listening


def server_of(guard: Guard, viewers: ViewersAddress | None = None) -> uvicorn.Server:
    """The server with everything behind the guard; that of `viewers` uses TLS."""
    tls = {} if viewers is None else {"ssl_certfile": viewers.certificate, "ssl_keyfile": str(viewers.key)}
    return uvicorn.Server(
        uvicorn.Config(
            guard,
            log_config=None,
            access_log=False,  # an address may contain a key
            lifespan="on" if viewers is None else "off",  # the pages start once
            ws_max_size=SOCKET_BYTES,
            ws_per_message_deflate=False,  # all clients are near
            timeout_graceful_shutdown=1,
            server_header=False,
            **tls,  # type: ignore[arg-type]  # files by name, as uvicorn takes them
        )
    )
