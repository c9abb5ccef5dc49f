"""A server of poses that exists only in the tests, and says exactly what a test wants said."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import numpy as np
from waiting import eventually

from drivers.openigtlink_tracker import OpenIGTLinkTracker
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.wire.openigtlink import Message, MessageReader, encode_message
from ronna_hw.wire.openigtlink_contents import Status, StatusCode, encode_status, encode_transform

MARKERS_MM = [[0.0, 0.0, 0.0], [45.0, 60.0, 0.0], [-30.0, 85.0, 0.0]]
TOOLS = [{"name": name, "markers_mm": MARKERS_MM} for name in ("robot_frame", "x_frame")]
STATUS_OK = encode_message("STATUS", "PlusServer", encode_status(Status(StatusCode.OK, "OK")))
BEGAN_NS = 1_700_000_000_000_000_000
FRAME_NS = 33_333_333
Say = Callable[[int], tuple[bytes, ...]]


def pose_at(x_mm: float, y_mm: float = 20.0, z_mm: float = -1500.0) -> Any:
    """A pose with an odd rotation, which a transposed matrix would not pass for."""
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, (x_mm, y_mm, z_mm)
    return pose


def transform(name: str, pose: Any, frame: int, **metadata: str) -> bytes:
    """A TRANSFORM of the frame of this number."""
    stamp_ns = BEGAN_NS + frame * FRAME_NS
    version = 2 if metadata else 1
    content = encode_transform(pose)
    return encode_message("TRANSFORM", name[:20], content, stamp_ns, version=version, metadata=metadata)


class PlusServer:
    """Server on a free port; `send` says something to every client, `heard` is what they said."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._peers: list[socket.socket] = []
        self.heard: list[Message] = []
        self.say: Say = lambda _frame: ()
        self._pushed: threading.Thread | None = None
        self._ended = threading.Event()
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._pushed is not None:
            self._pushed.join()
        self._listener.close()
        self.hang_up()

    @property
    def endpoint(self) -> str:
        return f"igtl://127.0.0.1:{self._listener.getsockname()[1]}"

    def send(self, *messages: bytes) -> None:
        for peer in list(self._peers):
            with contextlib.suppress(OSError):
                peer.sendall(b"".join(messages))

    def push(self, say: Say, period_s: float = 1 / 30) -> None:
        """Send `say(number of the frame)` again and again, as PLUS does; `say` may be replaced meanwhile."""
        self.say = say

        def go_on() -> None:
            frame = 0
            while not self._ended.wait(period_s):
                frame += 1
                self.send(*self.say(frame))

        self._pushed = threading.Thread(target=go_on, daemon=True)
        self._pushed.start()

    def hang_up(self) -> None:
        """Close every connection."""
        for peer in self._peers:
            with contextlib.suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)
            peer.close()
        self._peers.clear()

    def await_client(self) -> None:
        eventually(lambda: bool(self._peers))

    def _accept(self) -> None:
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                return
            self._peers.append(peer)
            threading.Thread(target=self._listen, args=(peer,), daemon=True).start()

    def _listen(self, peer: socket.socket) -> None:
        reader = MessageReader()
        with contextlib.suppress(OSError):
            while data := peer.recv(4096):
                self.heard.extend(reader.feed(data))


def make_tracker(endpoint: str, **options: Any) -> OpenIGTLinkTracker:
    """A tracker at this endpoint, with the usual two tools unless told otherwise."""
    config = DeviceConfig(
        driver="openigtlink_tracker", endpoint=endpoint, options={"tools": TOOLS, **options}
    )
    return OpenIGTLinkTracker("tracker", config, HostClock())
