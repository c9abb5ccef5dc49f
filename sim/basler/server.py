"""Server for both cameras of the stereo head: addresses and a single serving thread."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import selectors
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from ipaddress import IPv4Address

from ronna_hw.host.port_users import find_udp_port_user
from ronna_hw.wire.gige_vision import GVCP_ACK_HEADER, GVCP_PORT, PENDING_PAYLOAD, GevStatus, GvcpCommand
from sim.basler.camera.photographer import Photographer, PhotographerApart
from sim.basler.control.bootstrap import Identity
from sim.basler.control.privilege import Peer
from sim.basler.device import SimulatedCamera
from sim.basler.faults import CameraFaults
from sim.basler.message_channel import MessageChannel
from sim.basler.settings import TriggerMoments
from sim.errors import EndpointTaken
from sim.world.world import World

DATAGRAM_BYTES = 2048
IDLE_CHECK_S = 0.5
SCRIPTED_CHECK_S = 0.01  # while there is a fault script: how quickly its events take effect
# A datagram is answered before the next is read, so one camera's backlog cannot starve the other.
DATAGRAMS_AT_ONCE = 64

# UDP port 3956 is fixed by the standard, so each camera needs an address of its own.
FIRST_ADDRESS = IPv4Address("127.77.0.1")
PAIRS_TRIED = 2000
BROADCAST_ADDRESSES = ("255.255.255.255", "127.255.255.255")

SIDES = ("left", "right")


class CameraPair:
    """Two cameras in one world, served until `end` is called."""

    def __init__(self, world: World, addresses: Sequence[str] = (), *, info: str = "none") -> None:
        """Bind the addresses; `info` tells every client whose cameras these are, as a broadcast finds all."""
        truths = (world.scene.left, world.scene.right)
        # one board for the thread that takes images, another for the server's thread
        seen = [CameraFaults(world, truth, side) for side, truth in zip(SIDES, truths, strict=True)]
        self._apart = PhotographerApart(world, truths[1], seen[1])
        sources = (Photographer(world, truths[0], seen[0]), self._apart)
        sockets = bind_pair(addresses)
        moments = TriggerMoments(world.clock)
        self._cameras: list[SimulatedCamera] = []
        for side, truth, source, control in zip(SIDES, truths, sources, sockets, strict=True):
            faults = CameraFaults(world, truth, side)
            self._cameras.append(
                SimulatedCamera(
                    Identity(control.getsockname()[0], truth.serial, side, info),
                    source,
                    world.clock,
                    moments,
                    faults=faults,
                    is_line_lit=lambda: self._cameras[0].lights_exposure,  # wired to the left camera
                )
            )
        self._server = ControlServer(self._cameras, sockets, bind_broadcast(), _report)

    @property
    def endpoints(self) -> dict[str, str]:
        """Endpoints of both cameras."""
        return {
            side: f"gev://{camera.identity.address}"
            for side, camera in zip(SIDES, self._cameras, strict=True)
        }

    def serve(self) -> None:
        """Serve clients until `end` is called."""
        for camera in self._cameras:
            camera.open()
        try:
            self._server.serve()
        finally:
            for camera in self._cameras:
                camera.close()
            self._apart.close()

    def end(self) -> None:
        """Make `serve` return soon."""
        self._server.end()


def _report(message: str) -> None:
    sys.stderr.write(message + "\n")


def bind_pair(addresses: Sequence[str]) -> tuple[socket.socket, socket.socket]:
    """Bind control sockets to the two given addresses, or else to a free pair; raises SIM-004."""
    if addresses:
        left, right = addresses
        return _bind(left, right)
    for pair in range(PAIRS_TRIED):
        with contextlib.suppress(EndpointTaken):
            return _bind(str(FIRST_ADDRESS + 2 * pair), str(FIRST_ADDRESS + 2 * pair + 1))
    raise EndpointTaken(
        f"no pair of addresses from {FIRST_ADDRESS} on has UDP port {GVCP_PORT} free",
        limit=f"{PAIRS_TRIED} pairs tried",
    )


def bind_broadcast() -> list[socket.socket]:
    """Bind sockets for receiving broadcasts, which other programs may share."""
    sockets = []
    for address in BROADCAST_ADDRESSES:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((address, GVCP_PORT))
        except OSError:  # a program that does not share: cameras can then be found by address only
            listener.close()
            continue
        sockets.append(listener)
    return sockets


def _bind(left: str, right: str) -> tuple[socket.socket, socket.socket]:
    first = _bind_one(left)
    try:
        return first, _bind_one(right)
    except EndpointTaken:
        first.close()
        raise


def _bind_one(address: str) -> socket.socket:
    control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        control.bind((address, GVCP_PORT))
    except OSError as error:
        control.close()
        holder = find_udp_port_user(address, GVCP_PORT)
        what = f"UDP port {GVCP_PORT} of {address}"
        raise EndpointTaken.from_system(error, what, holder=holder) from error
    return control


class ControlServer:
    """Serves the control ports of several cameras on one thread, including broadcasts and heartbeats.

    `sockets` are the control sockets of `cameras`, in the same order; `shared` receive broadcasts.
    """

    def __init__(
        self,
        cameras: Sequence[SimulatedCamera],
        sockets: Sequence[socket.socket],
        shared: Sequence[socket.socket],
        report: Callable[[str], None],
    ) -> None:
        self._cameras = list(zip(cameras, sockets, strict=True))
        self._report = report
        self._selector = selectors.DefaultSelector()
        self._waker, self._sleeper = socket.socketpair()
        self._ended = False
        self._late: list[tuple[float, int, socket.socket, bytes, Peer]] = []  # answers delayed by a fault
        self._numbers = itertools.count()
        for each in (*sockets, *shared, self._sleeper, self._waker):
            each.setblocking(False)
        for camera, own in self._cameras:
            self._selector.register(own, selectors.EVENT_READ, [(camera, own)])
            self._selector.register(camera.messages.socket, selectors.EVENT_READ, camera.messages)
            camera.messages.changed = self._wake
        for listener in shared:
            self._selector.register(listener, selectors.EVENT_READ, self._cameras)
        self._selector.register(self._sleeper, selectors.EVENT_READ, None)

    def serve(self) -> None:
        """Serve until `end` is called."""
        while not self._ended:
            self._receive_all(self._wait_s())
            self._send_delayed()
            for camera, _ in self._cameras:
                camera.apply_faults()
                camera.messages.repeat_overdue()
                left_s = camera.privilege.seconds_left()
                if left_s is not None and left_s <= 0.0:
                    # a command may have arrived while this process had no time to look
                    self._receive_all(0.0)
                    camera.privilege.expire()

    def end(self) -> None:
        """Make `serve` return; safe to call from a signal handler or another thread."""
        self._ended = True
        self._wake()

    def _wake(self) -> None:
        """Wake the server to check for due work; safe to call from another thread."""
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def _wait_s(self) -> float:
        """Return the seconds until the next heartbeat, message, delayed answer or script check is due."""
        left = [camera.privilege.seconds_left() for camera, _ in self._cameras]
        check_s = SCRIPTED_CHECK_S if self._cameras[0][0].faults.scripted else IDLE_CHECK_S
        due_s = [self._late[0][0] - time.monotonic()] if self._late else []
        messages = (camera.messages.due_s() for camera, _ in self._cameras)
        due_s += [each - time.monotonic() for each in messages if each is not None]
        return max(0.0, min([check_s, *due_s, *(each for each in left if each is not None)]))

    def _receive_all(self, wait_s: float) -> None:
        for key, _ in self._selector.select(wait_s):
            if key.data is None:
                with contextlib.suppress(OSError):
                    self._sleeper.recv(DATAGRAM_BYTES)
            elif isinstance(key.data, MessageChannel):
                key.data.receive()
            else:
                self._receive(key.fileobj, key.data)  # type: ignore[arg-type]

    def _send_delayed(self) -> None:
        while self._late and self._late[0][0] <= time.monotonic():
            _, _, own, answer, peer = heapq.heappop(self._late)
            with contextlib.suppress(OSError):
                own.sendto(answer, peer)

    def _receive(self, source: socket.socket, cameras: list[tuple[SimulatedCamera, socket.socket]]) -> None:
        for _ in range(DATAGRAMS_AT_ONCE):
            try:
                datagram, peer = source.recvfrom(DATAGRAM_BYTES)
            except OSError:  # nothing more, or an error because an earlier receiver is gone
                return
            for camera, own in cameras:
                if _is_same_network(camera.identity.address, peer[0]):
                    self._answer(camera, own, datagram, peer)

    def _answer(
        self, camera: SimulatedCamera, own: socket.socket, datagram: bytes, peer: tuple[str, int]
    ) -> None:
        if camera.faults.active("unplug"):
            return
        try:
            answer = camera.port.answer(datagram, peer)
        except Exception as problem:  # an error here must cost one answer, not both cameras
            self._report(f"{camera.identity.user_name}: {type(problem).__name__}: {problem}")
            return
        if answer is None:
            return
        for delay_s, part in _delay_answer(camera, answer):
            heapq.heappush(self._late, (time.monotonic() + delay_s, next(self._numbers), own, part, peer))
        self._send_delayed()


def _delay_answer(camera: SimulatedCamera, answer: bytes) -> Iterator[tuple[float, bytes]]:
    """Yield an answer's datagrams under the active faults, each with its delay in host time."""
    faults = camera.faults
    if not faults.scripted:
        yield 0.0, answer
        return
    if faults.draw_answer_loss():
        return
    pending_ms = faults.amount("pend_answers")
    if pending_ms:
        request_id = struct.unpack_from(GVCP_ACK_HEADER, answer)[3]
        words = struct.pack(PENDING_PAYLOAD, 0, round(pending_ms))
        head = struct.pack(
            GVCP_ACK_HEADER, GevStatus.SUCCESS, GvcpCommand.PENDING_ACK, len(words), request_id
        )
        yield 0.0, head + words
    yield max(pending_ms, faults.amount("delay_answers")) / 1e3, answer


def _is_same_network(own: str, other: str) -> bool:
    """Return whether camera and sender are both on the loopback network, or both outside it."""
    return IPv4Address(own).is_loopback == IPv4Address(other).is_loopback
