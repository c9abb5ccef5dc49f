"""Serves the control ports of several cameras on one thread: sockets, broadcasts, heartbeats."""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Callable, Sequence
from ipaddress import IPv4Address

from sim.basler.camera.device import Camera

DATAGRAM_BYTES = 2048
IDLE_CHECK_S = 0.5
# A datagram is answered before the next is read, so a stall of one camera's client cannot starve others.
DATAGRAMS_AT_ONCE = 64


class ControlServer:
    """`sockets` are the control sockets of `cameras`, in the same order; `shared` hear broadcasts."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        sockets: Sequence[socket.socket],
        shared: Sequence[socket.socket],
        tell: Callable[[str], None],
    ) -> None:
        self._cameras = list(zip(cameras, sockets, strict=True))
        self._tell = tell
        self._selector = selectors.DefaultSelector()
        self._waker, self._sleeper = socket.socketpair()
        self._ended = False
        for each in (*sockets, *shared, self._sleeper):
            each.setblocking(False)
        for camera, own in self._cameras:
            self._selector.register(own, selectors.EVENT_READ, [(camera, own)])
        for listener in shared:
            self._selector.register(listener, selectors.EVENT_READ, self._cameras)
        self._selector.register(self._sleeper, selectors.EVENT_READ, [])

    def serve(self) -> None:
        """Answer until `end`."""
        while not self._ended:
            for key, _ in self._selector.select(self._patience_s()):
                if key.data:
                    self._receive(key.fileobj, key.data)  # type: ignore[arg-type]
            for camera, _ in self._cameras:
                camera.privilege.expire()

    def end(self) -> None:
        """Make `serve` return. May be called from a signal handler or another thread."""
        self._ended = True
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def _patience_s(self) -> float:
        """Until the next owner may lose control."""
        left = [camera.privilege.seconds_left() for camera, _ in self._cameras]
        return max(0.0, min([IDLE_CHECK_S, *(each for each in left if each is not None)]))

    def _receive(self, source: socket.socket, cameras: list[tuple[Camera, socket.socket]]) -> None:
        for _ in range(DATAGRAMS_AT_ONCE):
            try:
                datagram, peer = source.recvfrom(DATAGRAM_BYTES)
            except OSError:  # nothing more, or the word that an earlier receiver is gone
                return
            for camera, own in cameras:
                if _same_network(camera.identity.address, peer[0]):
                    self._answer(camera, own, datagram, peer)

    def _answer(self, camera: Camera, own: socket.socket, datagram: bytes, peer: tuple[str, int]) -> None:
        try:
            answer = camera.port.answer(datagram, peer)
        except Exception as problem:  # a mistake here must cost one answer, not both cameras
            self._tell(f"{camera.identity.user_name}: {type(problem).__name__}: {problem}")
            return
        if answer is not None:
            with contextlib.suppress(OSError):
                own.sendto(answer, peer)


def _same_network(own: str, other: str) -> bool:
    """A camera on the loopback network does not answer broadcasts from outside."""
    return IPv4Address(own).is_loopback == IPv4Address(other).is_loopback
