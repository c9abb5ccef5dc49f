"""Camera stream, received packet by packet without resends."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from conformance.case import check, read_as, require_present
from conformance.gige.client import GigeFeatures, GigeLink, camera_control
from ronna_hw.wire.gige_vision import TIMESTAMP_LATCH, Bootstrap, GvcpCommand

FRAME_LIMIT_S = 10.0  # for an image; a busy computer may draw it slowly
SILENCE_S = 0.3  # a stream without packets for this long is silent
WIDTH_PX, HEIGHT_PX = 256, 64
PACKET_BYTES = 1500
BUFFER_BYTES = 4 << 20
LEADER, TRAILER, PAYLOAD = 1, 2, 3


@dataclass(frozen=True)
class Packet:
    """GVSP packet; `raw` is everything after the status."""

    status: int
    block_id: int
    kind: int
    packet_id: int
    content: bytes
    raw: bytes


@dataclass(frozen=True)
class SeenLeader:
    """Fields of a GVSP leader packet."""

    payload_type: int
    ticks: int
    pixel_format: int
    width: int
    height: int
    x: int
    y: int


class GigeStream:
    """Receiver of a camera's stream, packet by packet."""

    def __init__(self, link: GigeLink) -> None:
        self.link = link
        self.features = GigeFeatures(link)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        self._socket.bind((link.local_address, 0))

    def __enter__(self) -> GigeStream:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()

    def latch_ticks(self) -> int:
        self.link.write(Bootstrap.TIMESTAMP_CONTROL, TIMESTAMP_LATCH)
        high, low = self.link.read_registers(Bootstrap.TIMESTAMP_HIGH, Bootstrap.TIMESTAMP_LOW)
        return high << 32 | low

    @property
    def port(self) -> int:
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        self._socket.close()

    def open_channel(self, destination: str | None = None) -> None:
        """Set the camera's stream destination, by default the local address."""
        address = socket.inet_aton(destination or self.link.local_address)
        self.link.write(Bootstrap.SCDA, int.from_bytes(address, "big"))
        self.link.write(Bootstrap.SCP, self.port)
        self.link.write(Bootstrap.SCPS, PACKET_BYTES)

    def configure_small_frames(self, **choices: int | str) -> None:
        """Load the power-on settings, then set a small area, software triggers and `choices`."""
        features = self.features
        features.execute("AcquisitionStop")
        features.set("UserSetSelector", "Default")
        features.execute("UserSetLoad")
        for name, value in {
            "AcquisitionMode": "Continuous",
            "TriggerSelector": "FrameStart",
            "TriggerSource": "Software",
            "TriggerMode": "On",
            "Width": WIDTH_PX,
            "Height": HEIGHT_PX,
            **choices,
        }.items():
            features.set(name, value)

    def trigger(self) -> None:
        """Trigger one frame."""
        self.features.execute("TriggerSoftware")

    def packet(self, limit_s: float = FRAME_LIMIT_S) -> Packet | None:
        """Receive the next packet, or return None if none arrives in time."""
        data = self.datagram(limit_s)
        if data is None:
            return None
        check(len(data) >= 8, "a stream header of 8 bytes", len(data))
        status, block_id, word = struct.unpack_from(">HHI", data)
        return Packet(status, block_id, word >> 24 & 0x7F, word & 0xFFFFFF, data[8:], data[2:])

    def datagram(self, limit_s: float) -> bytes | None:
        """Receive the next datagram, or return None if none arrives in time."""
        self._socket.settimeout(limit_s)
        try:
            return self._socket.recv(65536)
        except TimeoutError:
            return None

    def frame(self) -> list[Packet]:
        """Receive all packets up to the next trailer; raises Nonconformity if a packet is late."""
        found: list[Packet] = []
        deadline_s = time.monotonic() + FRAME_LIMIT_S
        while not found or found[-1].kind != TRAILER:
            packet = self.packet(max(0.001, deadline_s - time.monotonic()))
            found.append(require_present(packet, "a whole image", f"{len(found)} packets"))
        return found

    def silent(self) -> bool:
        """Return whether no packet arrives for `SILENCE_S`."""
        return self.datagram(SILENCE_S) is None

    def drain_packets(self, silence_s: float = SILENCE_S) -> list[Packet]:
        """Receive packets until a pause of `silence_s`; raises Nonconformity if the stream does not stop."""
        found: list[Packet] = []
        deadline_s = time.monotonic() + FRAME_LIMIT_S
        while (packet := self.packet(silence_s)) is not None:
            found.append(packet)
            check(time.monotonic() < deadline_s, "an end of the stream", f"{len(found)} more packets")
        return found

    def request_resend(self, block_id: int, first: int, last: int) -> None:
        """Request a resend of packets `first`..`last` of a block."""
        self.link.send(GvcpCommand.PACKETRESEND, struct.pack(">HHII", 0, block_id, first, last))


def require_leader(frame: list[Packet]) -> SeenLeader:
    """Return the leader of a frame, which must be its first packet."""
    check(frame[0].kind == LEADER and frame[0].packet_id == 0, "the leader first", frame[0].kind)
    return decode_leader(frame[0])


@read_as("a whole leader")
def decode_leader(packet: Packet) -> SeenLeader:
    _, payload_type, ticks, pixel_format, width, height, x, y, _, _ = struct.unpack_from(
        ">HHQIIIIIHH", packet.content
    )
    return SeenLeader(payload_type, ticks, pixel_format, width, height, x, y)


@contextmanager
def controlled_stream(link: GigeLink) -> Iterator[GigeStream]:
    """Take control of a camera and yield its stream of small frames; restores power-on settings."""
    with camera_control(link):
        stream = GigeStream(link)
        try:
            stream.configure_small_frames()
            stream.open_channel()
            yield stream
        finally:
            link.write(*stream.features.command("AcquisitionStop"))
            link.write(Bootstrap.SCP, 0)
            link.write(*stream.features.command("UserSetLoad"))
            stream.close()


def start_acquisition(stream: GigeStream) -> GigeStream:
    stream.features.execute("AcquisitionStart")
    return stream
