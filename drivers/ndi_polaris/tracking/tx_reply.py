"""Decode the text of a TX reply with the options 0001, 0800 and 1000."""

from __future__ import annotations

import re

from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.tracking.reply import HandleReport, HandleState, TrackingReply
from ronna_hw.devices.readings import Vector3
from ronna_hw.wire.polaris import (
    LF,
    MAXIMUM_STRAYS,
    REPLY_DISABLED,
    REPLY_MISSING,
    REPLY_UNOCCUPIED,
    TX_ERROR_CHARACTERS,
    TX_ERROR_SCALE,
    TX_FRAME_DIGITS,
    TX_PORT_STATUS_DIGITS,
    TX_POSITION_CHARACTERS,
    TX_POSITION_SCALE,
    TX_QUATERNION_CHARACTERS,
    TX_QUATERNION_SCALE,
    TX_SYSTEM_STATUS_DIGITS,
)

_QUATERNION = rf"([+-][0-9]{{{TX_QUATERNION_CHARACTERS - 1}}})"
_POSITION = rf"([+-][0-9]{{{TX_POSITION_CHARACTERS - 1}}})"
_ERROR = rf"([+-][0-9]{{{TX_ERROR_CHARACTERS - 1}}})"
_STATUS_AND_FRAME = rf"([0-9A-F]{{{TX_PORT_STATUS_DIGITS}}})([0-9A-F]{{{TX_FRAME_DIGITS}}})"
_VALID = re.compile(_QUATERNION * 4 + _POSITION * 3 + _ERROR + _STATUS_AND_FRAME)
_MISSING = re.compile(REPLY_MISSING + _STATUS_AND_FRAME)
# Clients differ on whether a disabled or empty handle carries status and frame: both are accepted.
_ABSENT = re.compile(f"({REPLY_DISABLED}|{REPLY_UNOCCUPIED})(?:{_STATUS_AND_FRAME})?")
_HEX2 = re.compile("[0-9A-F]{2}")
_STATUS = re.compile(f"[0-9A-F]{{{TX_SYSTEM_STATUS_DIGITS}}}")
_HEX = re.compile("[0-9A-F]*")
_STRAY_CHARACTERS = 3 * TX_POSITION_CHARACTERS
_STRAY = re.compile(_POSITION * 3)


def decode_tx(text: str, *, strays: bool = True) -> TrackingReply:
    """Decode a text whose CRC has been checked; `strays`: option 1000 was requested.

    Raises NDI-006 when the text does not match the options.
    """
    count = _hex2(text[:2], "number of handles", text)
    *records, tail = text[2:].split(LF)
    if len(records) != count:
        raise _malformed(f"TX announces {count} handles but sends {len(records)}", text)
    handles = tuple(_handle(record, text) for record in records)
    positions: tuple[Vector3, ...] = ()
    outside: tuple[bool, ...] | None = ()
    if strays:
        block, tail = tail[:-TX_SYSTEM_STATUS_DIGITS], tail[-TX_SYSTEM_STATUS_DIGITS:]
        positions, outside = _strays(block, text)
    if not _STATUS.fullmatch(tail):
        raise _malformed("TX has no system status", text)
    return TrackingReply(handles, positions, outside, int(tail, 16))


def _handle(record: str, text: str) -> HandleReport:
    number, content = _hex2(record[:2], "handle", text), record[2:]
    if match := _VALID.fullmatch(content):
        q0, qx, qy, qz, tx, ty, tz, fit = (int(value) for value in match.groups()[:8])
        return HandleReport(
            number,
            HandleState.VALID,
            (
                q0 / TX_QUATERNION_SCALE,
                qx / TX_QUATERNION_SCALE,
                qy / TX_QUATERNION_SCALE,
                qz / TX_QUATERNION_SCALE,
            ),
            (tx / TX_POSITION_SCALE, ty / TX_POSITION_SCALE, tz / TX_POSITION_SCALE),
            fit / TX_ERROR_SCALE,
            int(match[9], 16),
            int(match[10], 16),
        )
    if match := _MISSING.fullmatch(content):
        return HandleReport(
            number,
            HandleState.MISSING,
            port_status=int(match[1], 16),
            frame=int(match[2], 16),
        )
    if match := _ABSENT.fullmatch(content):
        state = HandleState.DISABLED if match[1] == REPLY_DISABLED else HandleState.UNOCCUPIED
        return HandleReport(number, state)
    raise _malformed(f"unknown form of the TX record of handle {number:02X}", text)


def _strays(block: str, text: str) -> tuple[tuple[Vector3, ...], tuple[bool, ...] | None]:
    count = _hex2(block[:2], "number of strays", text)
    if count > MAXIMUM_STRAYS:
        raise _malformed(f"TX announces {count} strays", text)
    digits = (count + 3) // 4
    bits, rest = block[2 : 2 + digits], block[2 + digits :]
    if len(bits) != digits or not _HEX.fullmatch(bits):
        raise _malformed("TX has no out-of-volume bits for its strays", text)
    # One number, padded at the front: the first stray is the highest of the `count` low bits.
    number = int(bits, 16) if bits else 0
    outside = tuple(bool(number >> (count - 1 - k) & 1) for k in range(count))
    sent, odd = divmod(len(rest), _STRAY_CHARACTERS)
    if odd or sent not in (count, count - sum(outside)):
        raise _malformed(f"TX announces {count} strays but sends {len(rest)} characters", text)
    positions = tuple(
        _position(rest[k : k + _STRAY_CHARACTERS], text) for k in range(0, len(rest), _STRAY_CHARACTERS)
    )
    return positions, outside if sent == count else None


def _position(record: str, text: str) -> Vector3:
    match = _STRAY.fullmatch(record)
    if not match:
        raise _malformed("unknown form of a stray position in TX", text)
    x, y, z = (int(value) / TX_POSITION_SCALE for value in match.groups())
    return x, y, z


def _hex2(digits: str, what: str, text: str) -> int:
    if not _HEX2.fullmatch(digits):
        raise _malformed(f"TX has no {what}", text)
    return int(digits, 16)


def _malformed(what: str, text: str) -> MalformedReply:
    return MalformedReply(what, wire=text.encode("ascii", "replace"))
