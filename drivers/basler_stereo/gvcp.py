"""Encoding of GVCP commands and decoding of acknowledges; no I/O."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.basler_stereo.errors import CommandRefused, MalformedReply
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import GevStatus, GvcpCommand, GvcpFlag

LARGEST_DATAGRAM_BYTES = 65_536

_HEADER = struct.Struct(gev.GVCP_COMMAND_HEADER)
_ACK_HEADER = struct.Struct(gev.GVCP_ACK_HEADER)
_U32 = struct.Struct(gev.READREG_ITEM)


@dataclass(frozen=True)
class GvcpAcknowledge:
    """Decoded GVCP acknowledge; `status` 0 means success."""

    status: int
    command: int
    request_id: int
    payload: bytes


def encode(
    command: GvcpCommand, request_id: int, payload: bytes = b"", flags: GvcpFlag = GvcpFlag.ACK_REQUIRED
) -> bytes:
    """Encode a complete command datagram."""
    return _HEADER.pack(gev.GVCP_KEY, flags, command, len(payload), request_id) + payload


def encode_resend(request_id: int, block_id: int, first: int, last: int) -> bytes:
    """Encode a request to resend packets `first`..`last` of a block, without acknowledge."""
    payload = struct.pack(gev.PACKETRESEND_COMMAND, 0, block_id, first, last)
    return encode(GvcpCommand.PACKETRESEND, request_id, payload, GvcpFlag(0))


def decode(datagram: bytes) -> GvcpAcknowledge | None:
    """Decode an acknowledge, or return None if the datagram is truncated."""
    if len(datagram) < gev.GVCP_HEADER_BYTES:
        return None
    status, command, length, request_id = _ACK_HEADER.unpack_from(datagram)
    if len(datagram) < gev.GVCP_HEADER_BYTES + length:
        return None
    return GvcpAcknowledge(
        status, command, request_id, datagram[gev.GVCP_HEADER_BYTES : gev.GVCP_HEADER_BYTES + length]
    )


def require_success(acknowledge: GvcpAcknowledge, what: str) -> bytes:
    """Return the payload of a successful acknowledge; raises GEV-006 with the status."""
    if acknowledge.status != GevStatus.SUCCESS:
        refused = CommandRefused(f"{what} was rejected", got=status_name(acknowledge.status))
        refused.status = acknowledge.status
        raise refused
    return acknowledge.payload


def status_name(status: int) -> str:
    """Format a status as its name and number."""
    try:
        return f"{GevStatus(status).name.lower().replace('_', ' ')} (0x{status:04X})"
    except ValueError:
        return f"0x{status:04X}"


def read_register_command(address: int) -> bytes:
    """Return the payload of a READREG command for one register."""
    return _U32.pack(address)


def register_value(payload: bytes, what: str) -> int:
    """Extract the register value from a READREG acknowledge; raises GEV-008."""
    if len(payload) != gev.REGISTER_BYTES:
        raise MalformedReply(
            f"{what}: the reply has the wrong length",
            expected="4 bytes",
            got=f"{len(payload)} bytes",
            wire=payload,
        )
    return int(_U32.unpack(payload)[0])


def action_command(device_key: int, group_key: int, group_mask: int) -> bytes:
    """Return the payload of an ACTION command for immediate execution."""
    return struct.pack(gev.ACTION_COMMAND, device_key, group_key, group_mask)


def write_register_command(address: int, value: int) -> bytes:
    """Return the payload of a WRITEREG command for one register."""
    return struct.pack(gev.WRITEREG_ITEM, address, value)


def read_memory_command(address: int, count: int) -> bytes:
    """Return the payload of a READMEM command; `count` is a multiple of 4 and at most 536."""
    return struct.pack(gev.READMEM_COMMAND, address, 0, count)


def memory_data(payload: bytes, address: int, count: int) -> bytes:
    """Extract the data from a READMEM acknowledge; raises GEV-008."""
    if len(payload) != gev.REGISTER_BYTES + count or _U32.unpack_from(payload)[0] != address:
        raise MalformedReply(
            f"reading memory at 0x{address:X}: the reply has the wrong address or length",
            expected=f"{gev.REGISTER_BYTES + count} bytes",
            got=f"{len(payload)} bytes",
            wire=payload[:16],
        )
    return payload[gev.REGISTER_BYTES :]


def write_memory_command(address: int, data: bytes) -> bytes:
    """Return the payload of a WRITEMEM command; `data` is a multiple of 4 bytes."""
    return _U32.pack(address) + data


def pending_ms(payload: bytes) -> int:
    """Return the extra time requested by a PENDING acknowledge, ms, or 0 if unspecified."""
    if len(payload) < struct.calcsize(gev.PENDING_PAYLOAD):
        return 0
    return int(struct.unpack_from(gev.PENDING_PAYLOAD, payload)[1])
