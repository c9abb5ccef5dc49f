"""Our OpenIGTLink server with a case that stands, and messages on the wire that it would not send."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from linked_case import STANDING, LinkedCase, linked_case, moving
from painted_ct import write_series

from procedures.live.openigtlink.server import ServerOptions
from ronna_hw.wire.openigtlink import encode_message
from ronna_hw.wire.openigtlink_contents import encode_transform

HEADER_BYTES, CHECK_SUM_BYTES = 58, 8  # the check sum ends the header
PACKET_GAP_S = 0.1
VOXELS = np.full((3, 6, 4), -900, dtype=np.int16)
POSE = encode_message("TRANSFORM", "Tool", encode_transform(np.eye(4)))
OTHER = encode_message("OWNKIND", "Tool", b"12345")
WRONG_SUM = POSE[: HEADER_BYTES - CHECK_SUM_BYTES] + bytes(CHECK_SUM_BYTES) + POSE[HEADER_BYTES:]
IN_TWO = (POSE[: HEADER_BYTES // 2], POSE[HEADER_BYTES // 2 :])


@contextmanager
def served() -> Iterator[LinkedCase]:
    """Serve a case whose tool moves, with a CT."""
    ct = write_series(Path(mkdtemp()) / "ct", VOXELS)
    with linked_case(replace(ServerOptions(), ct=ct)) as case:
        case.tell(*STANDING)
        with moving(case):
            yield case


@contextmanager
def sending(*parts: bytes, keep: bool = True) -> Iterator[int]:
    """Send one client the parts, each in a packet of its own, and keep its connection or not.

    Yields the port.
    """
    with socket.create_server(("127.0.0.1", 0)) as listener:
        ended = threading.Event()
        if not keep:
            ended.set()
        threading.Thread(target=_send, args=(listener, parts, ended), daemon=True).start()
        try:
            yield listener.getsockname()[1]
        finally:
            ended.set()


def _send(listener: socket.socket, parts: Sequence[bytes], ended: threading.Event) -> None:
    connection, _ = listener.accept()
    with connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for part in parts:
            connection.sendall(part)
            ended.wait(PACKET_GAP_S)
        ended.wait()
