"""BX replies decoded independently of any driver: options 0001, 0002, 0800, 1000."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from conformance.case import Nonconformity, check
from ronna_hw.wire.polaris import HandleStatus, PortStatus

Vector3 = tuple[float, float, float]

TOOL_INFORMATION_BYTES = 11
POSITION_BYTES = 12
OPTION_TOOL_INFORMATION = 0x0002
OPTION_OUT_OF_VOLUME = 0x0800
OPTION_STRAYS = 0x1000


@dataclass(frozen=True)
class HandleSeen:
    """One handle: `pose` is q0 qx qy qz tx ty tz error, None if missing."""

    handle: str
    status: HandleStatus
    pose: tuple[float, ...] | None = None
    port_status: int = 0
    frame: int = 0

    @property
    def outside(self) -> bool:
        """Whether the unit reports the tool outside its volume."""
        return bool(self.port_status & PortStatus.OUT_OF_VOLUME)


@dataclass(frozen=True)
class Seen:
    """One complete reply; `strays_at` is the offset of the first stray's position in the body.

    `strays_outside` are the flags with the low bit of each byte first, as most clients read them,
    `strays_outside_mirrored` with the high bit first: the order is undocumented.
    """

    handles: tuple[HandleSeen, ...]
    strays_mm: tuple[Vector3, ...]
    strays_outside: tuple[bool, ...]
    strays_outside_mirrored: tuple[bool, ...]
    strays_at: int
    system_status: int

    @property
    def frame(self) -> int:
        """Number of the frame."""
        return max((handle.frame for handle in self.handles), default=0)


def read_body(body: bytes, options: int) -> Seen:
    """Decode a body with option 0001; raises Nonconformity if its length is wrong."""
    try:
        return _read_body(body, options)
    except (struct.error, IndexError) as error:
        raise Nonconformity(f"expected a whole body, got {len(body)} bytes: {error}") from error


def _read_body(body: bytes, options: int) -> Seen:
    at, handles = 1, []
    for _ in range(body[0]):
        handle, status = f"{body[at]:02X}", body[at + 1]
        at += 2
        if status == HandleStatus.DISABLED:
            handles.append(HandleSeen(handle, HandleStatus.DISABLED))
            continue
        check(status in (HandleStatus.VALID, HandleStatus.MISSING), "handle status 01, 02 or 04", status)
        pose = None
        if status == HandleStatus.VALID:
            pose = struct.unpack_from("<8f", body, at)
            at += 32
        port_status, frame = struct.unpack_from("<2I", body, at)
        at += 8 + (TOOL_INFORMATION_BYTES if options & OPTION_TOOL_INFORMATION else 0)
        handles.append(HandleSeen(handle, HandleStatus(status), pose, port_status, frame))
    strays: list[Vector3] = []
    outside: tuple[bool, ...] = ()
    mirrored: tuple[bool, ...] = ()
    strays_at = at
    if options & OPTION_STRAYS:
        count = body[at]
        bits = body[at + 1 : at + 1 + (count + 7) // 8]
        outside = tuple(bool(bits[index // 8] & 1 << index % 8) for index in range(count))
        mirrored = tuple(bool(bits[index // 8] & 0x80 >> index % 8) for index in range(count))
        strays_at = at = at + 1 + len(bits)
        positions = count if options & OPTION_OUT_OF_VOLUME else outside.count(False)
        for _ in range(positions):
            x, y, z = struct.unpack_from("<3f", body, at)
            strays.append((x, y, z))
            at += POSITION_BYTES
    check(len(body) == at + 2, f"{at + 2} bytes in the body", len(body))
    (system_status,) = struct.unpack_from("<H", body, at)
    return Seen(tuple(handles), tuple(strays), outside, mirrored, strays_at, system_status)


def placed(markers_mm: tuple[Vector3, ...], pose: tuple[float, ...]) -> list[Vector3]:
    """Markers of a tool in the tracker frame, for a pose with a scalar-first quaternion."""
    q0, qx, qy, qz, tx, ty, tz, _ = pose
    norm = math.sqrt(q0 * q0 + qx * qx + qy * qy + qz * qz)
    q0, qx, qy, qz = q0 / norm, qx / norm, qy / norm, qz / norm
    rows = (
        (1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - q0 * qz), 2 * (qx * qz + q0 * qy), tx),
        (2 * (qx * qy + q0 * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - q0 * qx), ty),
        (2 * (qx * qz - q0 * qy), 2 * (qy * qz + q0 * qx), 1 - 2 * (qx * qx + qy * qy), tz),
    )
    moved = [tuple(a * x + b * y + c * z + t for a, b, c, t in rows) for x, y, z in markers_mm]
    return [(x, y, z) for x, y, z in moved]
