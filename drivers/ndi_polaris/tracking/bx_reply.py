"""Decode the body of a BX reply with the options 0001, 0800 and 1000."""

from __future__ import annotations

import struct

from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.tracking.reply import HandleReport, HandleState, TrackingReply
from ronna_hw.devices.readings import Vector3
from ronna_hw.wire.polaris import MAXIMUM_STRAYS, HandleStatus

_POSE = struct.Struct("<8f2I")  # Q0 Qx Qy Qz Tx Ty Tz error, port status, frame
_STATUS_AND_FRAME = struct.Struct("<2I")
_POSITION = struct.Struct("<3f")
_SYSTEM_STATUS = struct.Struct("<H")


def decode_bx(body: bytes, *, strays: bool = True) -> TrackingReply:
    """Decode a body whose CRC has been checked; `strays`: option 1000 was requested.

    Raises NDI-006 when the body does not match the options.
    """
    try:
        return _decode(body, strays)
    except (struct.error, IndexError) as error:
        raise MalformedReply("a BX reply is too short", wire=body) from error


def _decode(body: bytes, with_strays: bool) -> TrackingReply:
    at = 1
    handles = []
    for _ in range(body[0]):
        number, status = body[at], body[at + 1]
        at += 2
        if status == HandleStatus.VALID:
            q0, qx, qy, qz, tx, ty, tz, fit, port, frame = _POSE.unpack_from(body, at)
            at += _POSE.size
            rotation, position = (q0, qx, qy, qz), (tx, ty, tz)
            handles.append(HandleReport(number, HandleState.VALID, rotation, position, fit, port, frame))
        elif status == HandleStatus.MISSING:
            port, frame = _STATUS_AND_FRAME.unpack_from(body, at)
            at += _STATUS_AND_FRAME.size
            handles.append(HandleReport(number, HandleState.MISSING, port_status=port, frame=frame))
        elif status == HandleStatus.DISABLED:
            handles.append(HandleReport(number, HandleState.DISABLED))
        else:
            raise MalformedReply(f"BX: unknown status {status:02X} of handle {number:02X}", wire=body)
    positions: tuple[Vector3, ...] = ()
    outside: tuple[bool, ...] | None = ()
    if with_strays:
        positions, outside, at = _strays(body, at)
    (system,) = _SYSTEM_STATUS.unpack_from(body, at)
    if at + _SYSTEM_STATUS.size != len(body):
        raise MalformedReply("a BX reply is too long", wire=body)
    return TrackingReply(tuple(handles), positions, outside, system)


def _strays(body: bytes, at: int) -> tuple[tuple[Vector3, ...], tuple[bool, ...] | None, int]:
    count = body[at]
    if count > MAXIMUM_STRAYS:
        raise MalformedReply(f"BX announces {count} strays", limit=str(MAXIMUM_STRAYS), wire=body)
    bits = int.from_bytes(body[at + 1 : at + 1 + (count + 7) // 8], "little")
    outside = tuple(bool(bits >> k & 1) for k in range(count)) if bits else (False,) * count
    at += 1 + (count + 7) // 8
    # Units may omit positions outside the volume; the remaining length shows whether they did.
    sent, odd = divmod(len(body) - _SYSTEM_STATUS.size - at, _POSITION.size)
    if odd or sent not in (count, count - sum(outside)):
        raise MalformedReply(f"BX announces {count} strays but sends {sent}", wire=body)
    flat = struct.unpack_from(f"<{3 * sent}f", body, at)
    positions = tuple(zip(flat[0::3], flat[1::3], flat[2::3], strict=True))
    return positions, outside if sent == count else None, at + sent * _POSITION.size
