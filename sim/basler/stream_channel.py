"""Camera stream channel: frames sent as blocks of packets, with pacing and retransmission."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from ronna_hw.wire.gige_vision import (
    BLOCK_ID_FIRST,
    BLOCK_ID_LAST,
    GVSP_FORMAT_SHIFT,
    GVSP_HEADER,
    GVSP_LEADER,
    GVSP_OVERHEAD_BYTES,
    GVSP_TRAILER,
    IP_UDP_HEADER_BYTES,
    LEADER_PACKET_ID,
    TICK_FREQUENCY_HZ,
    GevStatus,
    GvspFormat,
    PayloadType,
)
from sim.basler.faults import NO_FAULTS, CameraFaults
from sim.basler.optics.canvas import Area
from sim.basler.settings import FrameSettings

KEPT_BLOCKS = 16
DEFAULT_PACKET_SIZE = 1500
SMALLEST_PACKET_SIZE = 220
LARGEST_PACKET_SIZE = 16404
PACKET_SIZE_STEP = 4
WIRE_BYTES_PER_S = 125e6  # 1 Gbit/s
BURST_BYTES = 32 * 1024  # sent at once; a default kernel buffers about six of these for a receiver
SHORTEST_SLEEP_S = 2e-4  # shorter sleeps take longer than requested
LONGEST_CREDIT_S = 1.5e-3  # link time that a late sender may catch up at once: the kernel's buffer
IP_MTU_DISCOVER = 10  # from linux/in.h; not in Python's socket module
PMTU_DO, PMTU_DONT = 2, 0

WRONG_AREA_PX = 16  # offset of a leader's area from the true one under that fault


@dataclass(frozen=True)
class SentImage:
    """Encoded image with its exposure settings and time stamp in ticks."""

    settings: FrameSettings
    image: bytes
    stamp_ticks: int


class Block:
    """Leader, payload and trailer packets of a frame, built on demand."""

    def __init__(self, block_id: int, frame: SentImage, packet_size: int) -> None:
        self.block_id = block_id
        self._frame = frame
        self._image = memoryview(frame.image)
        self._share = packet_size - GVSP_OVERHEAD_BYTES
        self._payloads = -(-len(frame.image) // self._share)

    @property
    def trailer_id(self) -> int:
        """Packet id of the trailer, the last packet."""
        return self._payloads + 1

    def packet(
        self, packet_id: int, status: GevStatus = GevStatus.SUCCESS
    ) -> tuple[bytes, bytes | memoryview]:
        """Return the header and content of packet `packet_id`, from 0 to `trailer_id`."""
        if packet_id == LEADER_PACKET_ID:
            return header(status, self.block_id, GvspFormat.LEADER, packet_id), self._encode_leader()
        if packet_id == self.trailer_id:
            trailer = struct.pack(GVSP_TRAILER, 0, PayloadType.IMAGE, self._frame.settings.area.height)
            return header(status, self.block_id, GvspFormat.TRAILER, packet_id), trailer
        start = (packet_id - 1) * self._share
        content = self._image[start : start + self._share]
        return header(status, self.block_id, GvspFormat.PAYLOAD, packet_id), content

    def _encode_leader(self) -> bytes:
        settings = self._frame.settings
        area = settings.area
        geometry = (area.width, area.height, area.x, area.y)
        return struct.pack(
            GVSP_LEADER, 0, PayloadType.IMAGE, self._frame.stamp_ticks, settings.pixel_format, *geometry, 0, 0
        )


def header(status: GevStatus, block_id: int, kind: GvspFormat, packet_id: int) -> bytes:
    """Encode a stream packet header."""
    return struct.pack(GVSP_HEADER, status, block_id, kind << GVSP_FORMAT_SHIFT | packet_id)


class UdpChannel:
    """UDP channel from the camera to one receiver, with `owner_address` as its default destination."""

    port: int  # of the receiver; 0 while closed

    def __init__(self, address: str, owner_address: Callable[[], str | None], faults: CameraFaults) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((address, 0))
        self._owner_address = owner_address
        self._faults = faults
        self.destination = "0.0.0.0"

    @property
    def source_port(self) -> int:
        """UDP port from which the camera sends."""
        return int(self.socket.getsockname()[1])

    @property
    def receiver(self) -> tuple[str, int] | None:
        """Packet destination, or None while closed; 0.0.0.0 means the application in control."""
        owner = self._owner_address()
        if not self.port or owner is None:
            return None
        return (owner if self.destination == "0.0.0.0" else self.destination), self.port

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


class StreamChannel(UdpChannel):
    """Sends blocks to one receiver."""

    def __init__(
        self, address: str, owner_address: Callable[[], str | None], faults: CameraFaults = NO_FAULTS
    ) -> None:
        super().__init__(address, owner_address, faults)
        self._kept: deque[Block] = deque(maxlen=KEPT_BLOCKS)
        self._next_block_id = BLOCK_ID_FIRST
        self._do_not_fragment = False
        self.port = 0
        self.packet_size = DEFAULT_PACKET_SIZE
        self.delay_ticks = 0

    @property
    def do_not_fragment(self) -> bool:
        """Whether routers must not fragment packets."""
        return self._do_not_fragment

    @do_not_fragment.setter
    def do_not_fragment(self, enabled: bool) -> None:
        self._do_not_fragment = enabled
        self.socket.setsockopt(socket.IPPROTO_IP, IP_MTU_DISCOVER, PMTU_DO if enabled else PMTU_DONT)

    def begin(self) -> None:
        """Restart block numbers from 1, discarding older blocks so that they can no longer be resent."""
        self._next_block_id = BLOCK_ID_FIRST
        self._kept.clear()

    def block_of(self, frame: SentImage) -> Block | None:
        """Create the next block to send, or return None while the channel is closed."""
        if self.receiver is None:
            return None
        block = Block(self._next_block_id, self._apply_faults(frame), self.packet_size)
        self._next_block_id = BLOCK_ID_FIRST if block.block_id == BLOCK_ID_LAST else block.block_id + 1
        self._kept.append(block)
        return block

    def send(self, block: Block, duration_s: float = 0.0) -> None:
        """Send a block over `duration_s` at the read-out pace, but no faster than the link allows."""
        receiver = self.receiver
        if receiver is None:
            return
        packets = block.trailer_id + 1
        lost = self._faults.draw_lost_packets(block.block_id, packets)
        pause_s = self.packet_size / WIRE_BYTES_PER_S + self.delay_ticks / TICK_FREQUENCY_HZ
        pause_s = max(pause_s, duration_s / packets)
        burst = max(1, BURST_BYTES // self.packet_size)
        due_s = time.monotonic()
        for position, packet_id in enumerate(self._faults.draw_packet_order(block.block_id, packets)):
            if position % burst == 0:
                now_s = time.monotonic()
                if due_s - now_s > SHORTEST_SLEEP_S:
                    time.sleep(due_s - now_s)
                # after a stall, the backlog is not sent faster than the link would carry it
                due_s = max(due_s, now_s - LONGEST_CREDIT_S) + burst * pause_s
            if packet_id not in lost:
                self._transmit(block.packet(packet_id), receiver)

    def repeat(self, block_id: int, first_packet: int, last_packet: int) -> None:
        """Resend packets, or report the first as unavailable."""
        receiver = self.receiver
        if receiver is None:
            return
        block = next((kept for kept in tuple(self._kept) if kept.block_id == block_id), None)
        if block is None or first_packet > block.trailer_id or self._faults.active("forget"):
            content = header(GevStatus.PACKET_UNAVAILABLE, block_id, GvspFormat.PAYLOAD, first_packet)
            self._transmit([content], receiver)
            return
        for packet_id in range(first_packet, min(last_packet, block.trailer_id) + 1):
            self._transmit(block.packet(packet_id, GevStatus.PACKET_RESEND), receiver)

    def fire_test_packet(self, size: int) -> None:
        """Send one datagram of `size` bytes including IP and UDP headers, if the path carries it."""
        receiver = self.receiver
        if receiver is not None:
            self._transmit([bytes(size - IP_UDP_HEADER_BYTES)], receiver)

    def shut(self) -> None:
        """Close the channel and discard its blocks."""
        self.port = 0
        self._kept.clear()

    def _apply_faults(self, frame: SentImage) -> SentImage:
        if self._faults.active("truncate"):
            frame = replace(frame, image=frame.image[: len(frame.image) // 2])
        if self._faults.active("shift_area"):
            area = frame.settings.area
            wrong_area = Area(area.x + WRONG_AREA_PX, area.y, area.width, area.height)
            frame = replace(frame, settings=replace(frame.settings, area=wrong_area))
        return frame

    def _transmit(self, parts: Collection[bytes | memoryview], receiver: tuple[str, int]) -> None:
        if not self._faults.passes(sum(len(part) for part in parts) + IP_UDP_HEADER_BYTES):
            return
        # If the receiver is gone or the packet too large for the path, it is lost as on a real network.
        with contextlib.suppress(OSError):
            self.socket.sendmsg(parts, (), 0, receiver)
