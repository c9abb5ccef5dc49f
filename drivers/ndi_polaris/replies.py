"""Decoding of TX and BX replies with options 0001, 0002, 0800 and 1000, and assembly of readings. No I/O."""

from __future__ import annotations

import math
import re
import struct
from functools import lru_cache
from typing import NamedTuple

from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.measuring_volume import MeasuringVolume
from drivers.ndi_polaris.tool_loading import LoadedTool
from drivers.ndi_polaris.unit import DOUBTFUL_STATUS
from ronna_hw.devices.readings import Stamp, StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.vectors import Quaternion, Vector3
from ronna_hw.wire import polaris as ndi
from ronna_hw.wire.polaris import HandleStatus, MarkerState, PortStatus, ReplyOption

FRAME_OPTIONS = (
    ReplyOption.TRANSFORMS
    | ReplyOption.TOOL_INFORMATION
    | ReplyOption.OUT_OF_VOLUME
    | ReplyOption.STRAY_PASSIVE
)
# Plain numbers: joining flags takes a microsecond each.
_WITH_INFORMATION, _WITH_STRAYS = ReplyOption.TOOL_INFORMATION.value, ReplyOption.STRAY_PASSIVE.value
LEAST_USED = 3  # markers of a pose: a unit that states fewer has another order of the digits
NORM_TOLERANCE = 1e-2  # rounding in TX changes the norm by 1e-4; beyond this it is not a rotation
FARTHEST_MM = 9999.99  # limit of the unit's text format
DISTURBED = 0x7F00  # every bit above the low byte reports a disturbed measurement
REMARKABLE_PORT_STATUS = int(PortStatus.OUT_OF_VOLUME | PortStatus.PARTIALLY_OUT_OF_VOLUME) | DISTURBED
_BX_POSE = struct.Struct("<8f2I")  # Q0 Qx Qy Qz Tx Ty Tz error, port status, frame
_BX_STATUS_AND_FRAME = struct.Struct("<2I")
_BX_INFORMATION = struct.Struct(f"<B{ndi.MARKER_DIGITS // 2}s")  # tool information, a marker each half byte
_BX_POSITION = struct.Struct("<3f")
_BX_SYSTEM_STATUS = struct.Struct("<H")
_QUATERNION = rf"([+-][0-9]{{{ndi.TX_QUATERNION_CHARACTERS - 1}}})"
_POSITION = rf"([+-][0-9]{{{ndi.TX_POSITION_CHARACTERS - 1}}})"
_ERROR = rf"([+-][0-9]{{{ndi.TX_ERROR_CHARACTERS - 1}}})"
_STATUS_AND_FRAME = rf"([0-9A-F]{{{ndi.TX_PORT_STATUS_DIGITS}}})([0-9A-F]{{{ndi.TX_FRAME_DIGITS}}})"
_INFORMATION = rf"(?:[0-9A-F]{{2}}([0-9A-F]{{{ndi.MARKER_DIGITS}}}))?"
_VALID = re.compile(_QUATERNION * 4 + _POSITION * 3 + _ERROR + _STATUS_AND_FRAME + _INFORMATION)
_MISSING = re.compile(ndi.REPLY_MISSING + _STATUS_AND_FRAME + _INFORMATION)
# Clients differ on whether a disabled or empty handle carries status and frame: both are accepted.
_ABSENT = re.compile(f"({ndi.REPLY_DISABLED}|{ndi.REPLY_UNOCCUPIED})(?:{_STATUS_AND_FRAME})?")
_HEX2 = re.compile("[0-9A-F]{2}")
_STATUS = re.compile(f"[0-9A-F]{{{ndi.TX_SYSTEM_STATUS_DIGITS}}}")
_HEX = re.compile("[0-9A-F]*")
_STRAY_CHARACTERS = 3 * ndi.TX_POSITION_CHARACTERS
_STRAY = re.compile(_POSITION * 3)


class HandleReport(NamedTuple):
    """State of one handle, with pose and error only for a visible tool.

    Port status and frame also for a missing tool, neither for a disabled or unoccupied handle. The marker
    digits are hexadecimal, marker 0 first, and empty if not requested.
    """

    handle: int
    rotation: Quaternion | None = None  # tracker <- tool, scalar first, as sent: not yet normalised
    position_mm: Vector3 | None = None
    fit_error_mm: float | None = None
    port_status: int = 0  # bits of PortStatus
    frame: int | None = None
    marker_digits: str = ""


class TrackingReply(NamedTuple):
    """Decoded tracking reply, in a form common to TX and BX."""

    handles: tuple[HandleReport, ...]
    strays_mm: tuple[Vector3, ...]
    stray_outside: tuple[bool, ...] | None  # the unit's bits; None when it omitted those outside
    system_status: int  # bits of SystemStatus


def decode_bx(
    body: bytes, options: ReplyOption = FRAME_OPTIONS, *, first_marker_first: bool = False
) -> TrackingReply:
    """Decode a BX reply body with checked CRC to a request with these options.

    Raises NDI-006 when the body does not match them.
    """
    try:
        return _decode_bx_body(body, options, first_marker_first)
    except (struct.error, IndexError) as error:
        raise MalformedReply("a BX reply is too short", wire=body) from error


def _decode_bx_body(body: bytes, options: ReplyOption, first_marker_first: bool) -> TrackingReply:
    offset = 1
    handles = []
    with_information = options.value & _WITH_INFORMATION
    pose: tuple[Quaternion | None, Vector3 | None, float | None]
    for _ in range(body[0]):
        number, status = body[offset], body[offset + 1]
        offset += 2
        if status == HandleStatus.VALID:
            q0, qx, qy, qz, tx, ty, tz, fit, port, frame = _BX_POSE.unpack_from(body, offset)
            offset += _BX_POSE.size
            pose = (q0, qx, qy, qz), (tx, ty, tz), fit
        elif status == HandleStatus.MISSING:
            port, frame = _BX_STATUS_AND_FRAME.unpack_from(body, offset)
            offset += _BX_STATUS_AND_FRAME.size
            pose = None, None, None
        elif status == HandleStatus.DISABLED:  # no options apply
            handles.append(HandleReport(number))
            continue
        else:
            raise MalformedReply(f"BX: unknown status {status:02X} of handle {number:02X}", wire=body)
        digits = ""
        if with_information:
            _, nibbles = _BX_INFORMATION.unpack_from(body, offset)
            offset += _BX_INFORMATION.size
            digits = nibbles.hex() if first_marker_first else nibbles.hex()[::-1]
        rotation, position, fit_error_mm = pose
        report = HandleReport(number, rotation, position, fit_error_mm, port, frame, digits)
        handles.append(report)
    positions: tuple[Vector3, ...] = ()
    outside: tuple[bool, ...] | None = ()
    if options.value & _WITH_STRAYS:
        positions, outside, offset = _unpack_bx_strays(body, offset)
    (system,) = _BX_SYSTEM_STATUS.unpack_from(body, offset)
    if offset + _BX_SYSTEM_STATUS.size != len(body):
        raise MalformedReply("a BX reply is too long", wire=body)
    return TrackingReply(tuple(handles), positions, outside, system)


def _unpack_bx_strays(body: bytes, offset: int) -> tuple[tuple[Vector3, ...], tuple[bool, ...] | None, int]:
    if (count := body[offset]) > ndi.MAXIMUM_STRAYS:
        raise MalformedReply(f"BX announces {count} strays", limit=f"{ndi.MAXIMUM_STRAYS} strays", wire=body)
    bits = int.from_bytes(body[offset + 1 : offset + 1 + (count + 7) // 8], "little")
    outside = tuple(bool(bits >> k & 1) for k in range(count)) if bits else (False,) * count
    offset += 1 + (count + 7) // 8
    # Units may omit positions outside the volume; the remaining length shows whether they did.
    sent, remainder = divmod(len(body) - _BX_SYSTEM_STATUS.size - offset, _BX_POSITION.size)
    if remainder or sent not in (count, count - sum(outside)):
        raise MalformedReply(f"BX announces {count} strays but sends {sent}", wire=body)
    flat = struct.unpack_from(f"<{3 * sent}f", body, offset)
    positions = tuple(zip(flat[0::3], flat[1::3], flat[2::3], strict=True))
    return positions, outside if sent == count else None, offset + sent * _BX_POSITION.size


def decode_tx(
    text: str, options: ReplyOption = FRAME_OPTIONS, *, first_marker_first: bool = True
) -> TrackingReply:
    """Decode a TX reply text with checked CRC to a request with these options.

    Raises NDI-006 when the text does not match them.
    """
    count = _parse_hex2(text[:2], "number of handles", text)
    *records, tail = text[2:].split(ndi.LF)
    if len(records) != count:
        raise _malformed_error(f"TX announces {count} handles but sends {len(records)}", text)
    with_information = bool(options.value & _WITH_INFORMATION)
    handles = tuple(
        _parse_tx_handle(record, text, with_information, first_marker_first) for record in records
    )
    positions: tuple[Vector3, ...] = ()
    outside: tuple[bool, ...] | None = ()
    if options.value & _WITH_STRAYS:
        block, tail = tail[: -ndi.TX_SYSTEM_STATUS_DIGITS], tail[-ndi.TX_SYSTEM_STATUS_DIGITS :]
        positions, outside = _parse_tx_strays(block, text)
    if not _STATUS.fullmatch(tail):
        raise _malformed_error("TX has no system status", text)
    return TrackingReply(handles, positions, outside, int(tail, 16))


def _parse_tx_handle(
    record: str, text: str, with_information: bool, first_marker_first: bool
) -> HandleReport:
    number, content = _parse_hex2(record[:2], "handle", text), record[2:]
    match = _VALID.fullmatch(content) or _MISSING.fullmatch(content)
    if match is None:
        if _ABSENT.fullmatch(content):
            return HandleReport(number)
        raise _malformed_error(f"unknown form of the TX record of handle {number:02X}", text)
    digits = match[match.re.groups] or ""
    if bool(digits) is not with_information:
        raise _malformed_error(f"the TX record of handle {number:02X} does not match the options", text)
    digits = digits if first_marker_first else digits[::-1]
    if match.re is _VALID:
        sent = [int(value) for value in match.groups()[:8]]
        w, x, y, z = (value / ndi.TX_QUATERNION_SCALE for value in sent[:4])
        tx, ty, tz = (value / ndi.TX_POSITION_SCALE for value in sent[4:7])
        fit_error_mm, port_status, frame = sent[7] / ndi.TX_ERROR_SCALE, int(match[9], 16), int(match[10], 16)
        return HandleReport(number, (w, x, y, z), (tx, ty, tz), fit_error_mm, port_status, frame, digits)
    return HandleReport(number, port_status=int(match[1], 16), frame=int(match[2], 16), marker_digits=digits)


def _parse_tx_strays(block: str, text: str) -> tuple[tuple[Vector3, ...], tuple[bool, ...] | None]:
    if (count := _parse_hex2(block[:2], "number of strays", text)) > ndi.MAXIMUM_STRAYS:
        raise _malformed_error(f"TX announces {count} strays", text)
    digits = (count + 3) // 4
    bits, rest = block[2 : 2 + digits], block[2 + digits :]
    if len(bits) != digits or not _HEX.fullmatch(bits):
        raise _malformed_error("TX has no out-of-volume bits for its strays", text)
    # One number, padded at the front: the first stray is the highest of the `count` low bits.
    number = int(bits, 16) if bits else 0
    outside = tuple(bool(number >> (count - 1 - k) & 1) for k in range(count))
    sent, remainder = divmod(len(rest), _STRAY_CHARACTERS)
    if remainder or sent not in (count, count - sum(outside)):
        raise _malformed_error(f"TX announces {count} strays but sends {len(rest)} characters", text)
    positions = tuple(
        _parse_tx_position(rest[k : k + _STRAY_CHARACTERS], text)
        for k in range(0, len(rest), _STRAY_CHARACTERS)
    )
    return positions, outside if sent == count else None


def _parse_tx_position(record: str, text: str) -> Vector3:
    if not (match := _STRAY.fullmatch(record)):
        raise _malformed_error("unknown form of a stray position in TX", text)
    x, y, z = (int(value) / ndi.TX_POSITION_SCALE for value in match.groups())
    return x, y, z


def _parse_hex2(digits: str, what: str, text: str) -> int:
    if not _HEX2.fullmatch(digits):
        raise _malformed_error(f"TX has no {what}", text)
    return int(digits, 16)


def _malformed_error(what: str, text: str) -> MalformedReply:
    return MalformedReply(what, wire=text.encode("ascii", "replace"))


def frame_number(reply: TrackingReply) -> int:
    """Return a reply's frame number; raises NDI-006 if no handle has one."""
    if not (numbers := [report.frame for report in reply.handles if report.frame is not None]):
        raise MalformedReply("no handle of the reply carries a frame number")
    return max(numbers)


def assemble_frame(
    reply: TrackingReply,
    tools: tuple[LoadedTool, ...],
    *,
    stamp: Stamp,
    repeated: bool,
    volume: MeasuringVolume | None,
    stray_to_marker_mm: float,
) -> TrackerFrame:
    """Assemble a frame from a reply: STALE if repeated, PARTIAL for a doubtful system status."""
    frame = frame_number(reply)
    reports = {report.handle: report for report in reply.handles}
    readings = []
    tracked_tools = []
    for tool in tools:
        if tool.name is None or tool.definition is None:
            continue
        markers = len(tool.definition.markers_mm)
        reading = _make_tool_reading(tool.name, reports.get(tool.handle), frame, markers)
        readings.append(reading)
        if reading.rotation is not None:
            tracked_tools.append((tool, reading))
    if repeated:
        validity = Validity.STALE
    else:
        validity = Validity.PARTIAL if reply.system_status & DOUBTFUL_STATUS else Validity.OK
    strays = _make_stray_readings(reply, tracked_tools, volume, stray_to_marker_mm) if reply.strays_mm else ()
    return TrackerFrame(stamp, validity, tuple(readings), strays)


def _make_tool_reading(name: str, report: HandleReport | None, frame: int, markers: int) -> ToolReading:
    if report is None or report.rotation is None or report.position_mm is None:
        outside = report is not None and report.port_status & PortStatus.OUT_OF_VOLUME.value
        return ToolReading(name, Validity.OUT_OF_VOLUME if outside else Validity.MISSING, None, None, None)
    rotation, error_mm = _normalise(report.rotation), report.fit_error_mm
    plausible = error_mm is not None and 0 <= error_mm <= FARTHEST_MM
    if rotation is None or not plausible or not _is_plausible_position(report.position_mm):
        return ToolReading(name, Validity.CORRUPT, None, None, None)
    used = _read_used(report.marker_digits, markers)
    return ToolReading(name, _report_validity(report, frame), rotation, report.position_mm, error_mm, used)


@lru_cache(maxsize=64)  # the same markers are used in most frames
def _read_used(digits: str, markers: int) -> tuple[bool, ...] | None:
    """Return which markers a pose was fitted to; None if the unit states fewer than that takes."""
    used = tuple(digit == str(MarkerState.USED.value) for digit in digits[:markers])
    return used if sum(used) >= LEAST_USED else None


def _report_validity(report: HandleReport, frame: int) -> Validity:
    if report.frame != frame:
        return Validity.STALE
    if not report.port_status & REMARKABLE_PORT_STATUS:
        return Validity.OK
    outside = report.port_status & PortStatus.OUT_OF_VOLUME.value
    return Validity.OUT_OF_VOLUME if outside else Validity.PARTIAL


def _make_stray_readings(
    reply: TrackingReply,
    tracked_tools: list[tuple[LoadedTool, ToolReading]],
    volume: MeasuringVolume | None,
    nearest_mm: float,
) -> tuple[StrayReading, ...]:
    strays = []
    for index, position in enumerate(reply.strays_mm):
        if not _is_plausible_position(position):
            continue  # a stray is only a position
        if _is_marker_of_any(tracked_tools, position, nearest_mm):
            continue
        inside = volume.contains(position) if volume is not None else None
        if inside is None:  # unknown volume: rely on the unit's own bit
            inside = reply.stray_outside is None or not reply.stray_outside[index]
        strays.append(StrayReading(position, Validity.OK if inside else Validity.OUT_OF_VOLUME))
    return tuple(strays)


def _is_marker_of_any(
    tracked_tools: list[tuple[LoadedTool, ToolReading]], position: Vector3, nearest_mm: float
) -> bool:
    """Return whether a stray is a marker of a tracked tool."""
    for tool, reading in tracked_tools:
        assert tool.definition is not None
        assert reading.rotation is not None
        assert reading.position_mm is not None
        if math.dist(position, reading.position_mm) > tool.radius_mm + nearest_mm:
            continue
        placed_mm = _to_tracker_mm(tool.definition.markers_mm, reading.rotation, reading.position_mm)
        if any(math.dist(position, marker) < nearest_mm for marker in placed_mm):
            return True
    return False


def _normalise(rotation: Quaternion) -> Quaternion | None:
    """Normalise a quaternion to a non-negative scalar part, or return None if it is not a rotation."""
    q0, qx, qy, qz = rotation
    norm = math.sqrt(q0 * q0 + qx * qx + qy * qy + qz * qz)
    if not abs(norm - 1.0) <= NORM_TOLERANCE:  # also rejects NaN
        return None
    scale = -1.0 / norm if q0 < 0 else 1.0 / norm
    return q0 * scale, qx * scale, qy * scale, qz * scale


def _is_plausible_position(position_mm: Vector3) -> bool:
    x, y, z = position_mm
    return -FARTHEST_MM <= z < 0 and -FARTHEST_MM <= x <= FARTHEST_MM and -FARTHEST_MM <= y <= FARTHEST_MM


def _to_tracker_mm(
    markers_mm: tuple[Vector3, ...], rotation: Quaternion, position_mm: Vector3
) -> list[Vector3]:
    """Transform markers to tracker coordinates by v + 2 w (u x v) + 2 u x (u x v) + t, q = (w, u)."""
    w, ux, uy, uz = rotation
    tx, ty, tz = position_mm
    placed_mm = []
    for x, y, z in markers_mm:
        cx, cy, cz = uy * z - uz * y, uz * x - ux * z, ux * y - uy * x
        placed_mm.append(
            (
                x + 2 * (w * cx + uy * cz - uz * cy) + tx,
                y + 2 * (w * cy + uz * cx - ux * cz) + ty,
                z + 2 * (w * cz + ux * cy - uy * cx) + tz,
            )
        )
    return placed_mm
