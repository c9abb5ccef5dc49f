"""Orders from the driver to its receiver process: one per datagram, with the file descriptors it needs."""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from dataclasses import asdict, dataclass

LONGEST_ORDER_BYTES = 4096
MOST_DESCRIPTORS = 4


@dataclass(frozen=True)
class OpenStream:
    """Receive a stream. Descriptors: stream socket, control socket, memory, channel for notes."""

    stream: int
    payload_bytes: int
    packet_bytes: int
    resend: bool


@dataclass(frozen=True)
class CloseStream:
    """Stop receiving a stream."""

    stream: int


@dataclass(frozen=True)
class ExpectBlock:
    """A block was triggered; request it if it has not begun after `patience_s`."""

    stream: int
    block_id: int
    patience_s: float


@dataclass(frozen=True)
class KeepAlive:
    """Send keep-alives to a camera. Descriptor: the control socket."""

    camera: int
    period_s: float


@dataclass(frozen=True)
class EndKeepAlive:
    """Stop sending them."""

    camera: int


Order = OpenStream | CloseStream | ExpectBlock | KeepAlive | EndKeepAlive
_KINDS: dict[str, type[Order]] = {
    kind.__name__: kind for kind in (OpenStream, CloseStream, ExpectBlock, KeepAlive, EndKeepAlive)
}


def send_order(channel: socket.socket, order: Order, descriptors: Sequence[int] = ()) -> None:
    """Raises OSError when the process is gone."""
    text = json.dumps({"order": type(order).__name__, **asdict(order)}).encode()
    socket.send_fds(channel, [text], list(descriptors))


def receive_order(channel: socket.socket) -> tuple[Order, list[int]] | None:
    """The next order and its descriptors; None when the driver is gone."""
    text, descriptors, _, _ = socket.recv_fds(channel, LONGEST_ORDER_BYTES, MOST_DESCRIPTORS)
    if not text:
        return None
    fields = json.loads(text)
    return _KINDS[fields.pop("order")](**fields), descriptors
