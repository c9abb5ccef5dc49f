"""OpenIGTLink server in front of the unit, as PlusServer is: it pushes, and serves tools only, no strays.

Read in its source: transforms are called `FromToTo`, and names cut after 20 bytes; a tool that is not seen is
not sent; header version 2 with metadata only to a client that has sent it; STATUS four times a second; the
interval of STT_TDATA, milliseconds, is compared with seconds.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

from ronna_hw.wire.openigtlink import (
    LONGEST_NAME_BYTES,
    Malformed,
    Message,
    MessageReader,
    StreamBroken,
    encode_message,
)
from ronna_hw.wire.openigtlink_contents import (
    TRACKING_6D,
    Status,
    StatusCode,
    TrackedTool,
    decode_subscription,
    encode_status,
    encode_tracking,
    encode_transform,
)
from ronna_hw.wire.polaris import PARAMETER_ILLUMINATOR_RATE, PortStatus
from sim.polaris.faults import Power, UnitFaults
from sim.polaris.line.server import EndSignal
from sim.polaris.tracker_unit import SimulatedUnit, UnitMode
from sim.polaris.unit.tool_definition import parse_definition, write_definition
from sim.world.rigid import Matrix, matrix_from, rotation_from_quaternion
from sim.world.scene.model import TrackerTool

DEVICE: Final = "PlusServer"
SENDING_PERIOD_S: Final = 1 / 30
# Where devices advance the time, each push takes the next frame: 1/60 s of theatre time passes.
STEPPED_PERIOD_S: Final = 1 / 480
STATUS_PERIOD_S: Final = 0.25
RECEIVE_BYTES: Final = 4096
MOST_UNSENT_BYTES: Final = 1 << 20  # for a client that does not read; then it is disconnected
OUTSIDE: Final = PortStatus.OUT_OF_VOLUME | PortStatus.PARTIALLY_OUT_OF_VOLUME
FULL_NAME, STATUS, IS_VALID = "IGTL_DEVICE_NAME", "TransformStatus", "TransformValid"


@dataclass
class _Client:
    peer: socket.socket
    reader: MessageReader = field(default_factory=MessageReader)
    unsent: bytearray = field(default_factory=bytearray)
    version: int = 1
    tracking_interval_s: float | None = None  # of TDATA; None until it is asked for
    tracking_due_s: float = 0.0

    def send(self, data: bytes) -> None:
        """Send what the peer takes now; raises OSError once too much waits."""
        self.unsent += data
        with contextlib.suppress(BlockingIOError):
            del self.unsent[: self.peer.send(self.unsent)]
        if len(self.unsent) > MOST_UNSENT_BYTES:
            raise OSError("the client does not read")


def load_tools(unit: SimulatedUnit, tools: Iterable[TrackerTool]) -> dict[int, str]:
    """Load tools; return the names of their transforms by handle."""
    unit.initialise()
    fastest = max(unit.model.illuminator_rates)
    unit.user_parameters.set(PARAMETER_ILLUMINATOR_RATE, str(fastest), tracking=False)
    names = {}
    for tool in tools:
        port = unit.ports.request()
        port.definition = parse_definition(write_definition(tool))
        port.initialised = port.enabled = True
        port.place = None if unit.measurer.is_mount_frame(port) else unit.ports.free_place()
        names[port.handle] = transform_name(tool)
    return names


def transform_name(tool: TrackerTool) -> str:
    """Return the name of a tool's transform, such as `RobotFrameToTracker` of `robot_frame`."""
    return "".join(word.capitalize() for word in tool.name.split("_")) + "ToTracker"


class OpenIGTLinkServer:
    """Serves any number of clients from one thread, at the pace of the host's clock.

    Where devices advance the time, the unit measures only while a client has asked for TDATA: the time stands
    still otherwise. How much of it passes between two readings then depends on the host.
    """

    def __init__(self, unit: SimulatedUnit, tools: Iterable[TrackerTool], end: EndSignal) -> None:
        self._unit, self._end = unit, end
        self._names = load_tools(unit, tools)
        self._faults = UnitFaults(unit)
        self._begun_utc_ns = time.time_ns() - unit.clock.now_ns()  # at theatre time 0
        self._clients: list[_Client] = []
        self._last_number = -1  # of a frame
        self._period_s = SENDING_PERIOD_S if unit.clock.paced else STEPPED_PERIOD_S

    def serve(self, listener: socket.socket) -> None:
        """Serve until told to end."""
        listener.setblocking(False)
        due_s = status_due_s = time.monotonic()
        while not self._end.given:
            wait_s = max(0.0, due_s - time.monotonic())
            waiting: list[EndSignal | socket.socket] = [
                self._end,
                listener,
                *(client.peer for client in self._clients),
            ]
            ready, _, _ = select.select(waiting, [], [], wait_s)
            if listener in ready:
                self._accept(listener)
            for client in [one for one in self._clients if one.peer in ready]:
                self._guard(client, self._receive)
            now_s = time.monotonic()
            if now_s < due_s:
                continue
            due_s = max(due_s + self._period_s, now_s)
            self._run_unit()
            self._push(now_s)
            if now_s >= status_due_s:
                status_due_s = now_s + STATUS_PERIOD_S
                for client in list(self._clients):
                    self._guard(client, self._send_status)
        for client in self._clients:
            client.peer.close()

    def _accept(self, listener: socket.socket) -> None:
        peer, _ = listener.accept()
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients.append(_Client(peer))

    def _guard(self, client: _Client, work: Callable[[_Client], None]) -> None:
        """Work for a client, and drop one that has left, does not read or sends no OpenIGTLink."""
        try:
            work(client)
        except (OSError, StreamBroken):
            client.peer.close()
            self._clients.remove(client)

    def _receive(self, client: _Client) -> None:
        data = client.peer.recv(RECEIVE_BYTES)
        if not data:
            raise OSError("the client has left")
        for message in client.reader.feed(data):
            client.version = max(client.version, message.version)
            with contextlib.suppress(Malformed):
                self._answer(client, message)

    def _answer(self, client: _Client, message: Message) -> None:
        """Answer a query; CLIENTINFO and all other types are ignored."""
        if message.fault:
            return
        if message.kind == "GET_STATUS":
            self._send_status(client)
        elif message.kind == "STT_TDATA":
            client.tracking_interval_s = float(decode_subscription(message.content).interval_ms)
            client.tracking_due_s = 0.0
            client.send(self._encode(client, "RTS_TDATA", DEVICE, b"\0"))
        elif message.kind == "STP_TDATA":
            client.tracking_interval_s = None
            client.send(self._encode(client, "RTS_TDATA", DEVICE, b"\0"))

    def _run_unit(self) -> None:
        """Track while somebody is to be served."""
        unit = self._unit
        clients = [one for one in self._clients if unit.clock.paced or one.tracking_interval_s is not None]
        if clients and unit.mode is not UnitMode.TRACKING:
            self._last_number = -1
            unit.start_tracking(restart=False)
        elif not clients and unit.mode is UnitMode.TRACKING:
            unit.stop()

    def _push(self, now_s: float) -> None:
        if self._unit.mode is not UnitMode.TRACKING:
            return
        number, poses = self._measure()
        if number == self._last_number:
            return
        self._last_number = number
        stamp_ns = self._begun_utc_ns + self._unit.frames.moment_ns(number)

        def send_poses(client: _Client) -> None:
            for name, pose in poses.items():
                client.send(self._encode(client, "TRANSFORM", name, encode_transform(pose), stamp_ns))
            interval_s = client.tracking_interval_s
            if interval_s is not None and poses and now_s >= client.tracking_due_s:
                client.tracking_due_s = now_s + interval_s
                tools = [TrackedTool(_cut(name), TRACKING_6D, pose) for name, pose in poses.items()]
                client.send(self._encode(client, "TDATA", DEVICE, encode_tracking(tools), stamp_ns))

        for client in list(self._clients):
            self._guard(client, send_poses)

    def _measure(self) -> tuple[int, dict[str, Matrix]]:
        """Return the number of the frame and the poses of the tools that are seen inside the volume.

        Poses are by the names of their transforms; a unit without power repeats its last frame.
        """
        if self._faults.any_active:
            if self._faults.power() is Power.GONE:
                return self._last_number, {}
            self._faults.apply()
        poses, frame = {}, self._unit.frame()
        for port, tracked in frame.tools:
            if tracked is not None and tracked.pose is not None and not tracked.volume_status & OUTSIDE:
                rotation = rotation_from_quaternion(tracked.pose.quaternion)
                poses[self._names[port.handle]] = matrix_from(tracked.pose.position_mm, rotation)
        return frame.number, poses

    def _send_status(self, client: _Client) -> None:
        client.send(self._encode(client, "STATUS", DEVICE, encode_status(Status(StatusCode.OK, "OK"))))

    def _encode(
        self, client: _Client, kind: str, name: str, content: bytes, stamp_ns: int | None = None
    ) -> bytes:
        if stamp_ns is None:
            stamp_ns = self._begun_utc_ns + self._unit.clock.now_ns()
        metadata = {FULL_NAME: name, STATUS: "OK", IS_VALID: "1"} if kind == "TRANSFORM" else {}
        return encode_message(kind, _cut(name), content, stamp_ns, version=client.version, metadata=metadata)


def _cut(name: str) -> str:
    return name[:LONGEST_NAME_BYTES]
