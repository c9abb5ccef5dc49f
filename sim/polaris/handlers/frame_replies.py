"""Replies to TX and BX: the same frame encoded as text or as little-endian bytes.

Options are bits of `ronna_hw.wire.polaris.ReplyOption`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HandleStatus, ReplyOption, ToolInformation
from sim.polaris.measurement.frame import MeasuredFrame, Stray
from sim.polaris.measurement.tracking_rules import ToolPose, TrackedTool, as_requested
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.ports import Port

# Plain numbers: joining flags takes a microsecond each.
TRANSFORMS, TOOL_INFORMATION = ReplyOption.TRANSFORMS.value, ReplyOption.TOOL_INFORMATION.value
STRAY_ACTIVE, TOOL_MARKERS = ReplyOption.STRAY_ACTIVE.value, ReplyOption.TOOL_MARKERS.value
OUT_OF_VOLUME, STRAY_PASSIVE = ReplyOption.OUT_OF_VOLUME.value, ReplyOption.STRAY_PASSIVE.value

Point = tuple[float, float, float]
Markers = list[tuple[Point, bool]]  # positions, and whether inside the volume

HEX_DIGIT_BITS = 4
LARGEST_POSITION = 999_999
LARGEST_ERROR = 99_999
FRAME_NUMBER_MASK = 0xFFFFFFFF

NO_POSITION = bytes(12)
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))

_HANDLE = struct.Struct("<BB")
_POSE = struct.Struct("<8f")
_STATUS = struct.Struct("<II")  # port status, frame number
_POINT = struct.Struct("<3f")
_U16 = struct.Struct("<H")


def text_reply(frame: MeasuredFrame, options: int, behaviour: UnitBehaviour) -> str:
    """Compose the TX reply without its CRC."""
    parts = [f"{len(frame.tools):02X}"]
    for port, tracked in frame.tools:
        parts.append(f"{port.handle:02X}")
        if port.enabled and port.occupied:
            parts.extend(_tool_text(frame, port, tracked, options, behaviour))
        else:
            parts.append(wire.REPLY_DISABLED if port.occupied else wire.REPLY_UNOCCUPIED)
            if behaviour.status_of_unseen_handles:
                parts.append(_status_text(frame, port, tracked))
        parts.append(wire.LF)
    if options & STRAY_PASSIVE:
        parts.append(_markers_text(*_select_strays(frame.strays, options), behaviour))
    parts.append(f"{int(frame.system_status):04X}")
    return "".join(parts)


def _tool_text(
    frame: MeasuredFrame, port: Port, tracked: TrackedTool | None, options: int, behaviour: UnitBehaviour
) -> list[str]:
    parts = []
    tracked = omit_unreported(tracked, options, behaviour)
    if options & TRANSFORMS:
        pose = None if tracked is None else tracked.pose
        parts.append(wire.REPLY_MISSING if pose is None else _pose_text(pose))
        parts.append(_status_text(frame, port, tracked))
    if options & TOOL_INFORMATION:
        digits = marker_digits(tracked, first_first=behaviour.first_marker_is_first_digit)
        parts.append(f"{information(tracked):02X}{digits}")
    if options & STRAY_ACTIVE:  # no tool of this unit has a stray active marker
        words = behaviour.text_active_stray == "words"
        parts.append(wire.REPLY_MISSING if words else f"{HandleStatus.MISSING:02X}")
    if options & TOOL_MARKERS:
        markers = list_markers(tracked)
        parts.append(_markers_text(markers, [position for position, _ in markers], behaviour))
    return parts


def _status_text(frame: MeasuredFrame, port: Port, tracked: TrackedTool | None) -> str:
    return f"{port_status(port, tracked):08X}{frame.number & FRAME_NUMBER_MASK:08X}"


def _pose_text(pose: ToolPose) -> str:
    quaternion = "".join(f"{round(value * wire.TX_QUATERNION_SCALE):+06d}" for value in pose.quaternion)
    error = min(round(pose.error_mm * wire.TX_ERROR_SCALE), LARGEST_ERROR)
    return f"{quaternion}{_position_text(pose.position_mm)}{error:+06d}"


def _position_text(position_mm: Point) -> str:
    scaled = (round(value * wire.TX_POSITION_SCALE) for value in position_mm)
    return "".join(f"{max(-LARGEST_POSITION, min(LARGEST_POSITION, value)):+07d}" for value in scaled)


def _markers_text(markers: Markers, sent_mm: list[Point], behaviour: UnitBehaviour) -> str:
    """Format the marker count, out-of-volume flags and positions to send."""
    outside = [not inside for _, inside in markers]
    bits = _format_bits(outside, first_is_high=behaviour.first_stray_is_high_bit)
    return f"{len(markers):02X}{bits}" + "".join(map(_position_text, sent_mm))


def _format_bits(flags: Sequence[bool], *, first_is_high: bool) -> str:
    """Format flags in hexadecimal, as one number with flag 0 highest or in order, four flags per digit."""
    digits = -(-len(flags) // HEX_DIGIT_BITS)
    if not digits:
        return ""
    if first_is_high:
        number = sum(1 << (len(flags) - 1 - k) for k, flag in enumerate(flags) if flag)
        return f"{number:0{digits}X}"
    groups = [flags[k : k + HEX_DIGIT_BITS] for k in range(0, len(flags), HEX_DIGIT_BITS)]
    return "".join(f"{sum(1 << k for k, flag in enumerate(group) if flag):X}" for group in groups)


def binary_body(frame: MeasuredFrame, options: int, behaviour: UnitBehaviour) -> bytes:
    """Compose the body of the BX reply."""
    parts = [bytes([len(frame.tools)])]
    for port, tracked in frame.tools:
        if port.enabled and port.occupied:
            parts.extend(_tool_bytes(frame, port, tracked, options, behaviour))
        else:  # no options apply
            parts.append(_HANDLE.pack(port.handle, HandleStatus.DISABLED))
    if options & STRAY_PASSIVE:
        parts.append(_markers_bytes(*_select_strays(frame.strays, options), behaviour))
    parts.append(_U16.pack(frame.system_status))
    return b"".join(parts)


def _tool_bytes(
    frame: MeasuredFrame, port: Port, tracked: TrackedTool | None, options: int, behaviour: UnitBehaviour
) -> list[bytes]:
    tracked = omit_unreported(tracked, options, behaviour)
    pose = None if tracked is None else tracked.pose
    parts = [_HANDLE.pack(port.handle, HandleStatus.MISSING if pose is None else HandleStatus.VALID)]
    if options & TRANSFORMS:
        if pose is not None:
            parts.append(_POSE.pack(*pose.quaternion, *pose.position_mm, pose.error_mm))
        parts.append(_STATUS.pack(port_status(port, tracked), frame.number & FRAME_NUMBER_MASK))
    if options & TOOL_INFORMATION:
        digits = marker_digits(tracked, first_first=behaviour.first_marker_is_first_nibble)
        parts.append(bytes([information(tracked)]) + bytes.fromhex(digits))
    if options & STRAY_ACTIVE:  # no tool of this unit has a stray active marker
        always = behaviour.binary_active_stray_always
        parts.append(bytes([HandleStatus.MISSING]) + NO_POSITION if always else b"\0")
    if options & TOOL_MARKERS:
        markers = list_markers(tracked)
        parts.append(_markers_bytes(markers, [position for position, _ in markers], behaviour))
    return parts


def _markers_bytes(markers: Markers, sent_mm: list[Point], behaviour: UnitBehaviour) -> bytes:
    """Encode the marker count, out-of-volume flags (eight per byte, in unit bit order) and positions."""
    number = sum(1 << k for k, (_, inside) in enumerate(markers) if not inside)
    flags = number.to_bytes(-(-len(markers) // 8), "little")
    flags = flags if behaviour.first_stray_is_low_bit else flags.translate(MIRRORED)
    return bytes([len(markers)]) + flags + b"".join(_POINT.pack(*position) for position in sent_mm)


def omit_unreported(
    tracked: TrackedTool | None, options: int, behaviour: UnitBehaviour
) -> TrackedTool | None:
    """Strip out-of-volume tool data enabled neither by the request nor by the unit's settings."""
    if tracked is None or not tracked.volume_status:
        return tracked
    outside = bool(options & OUT_OF_VOLUME)
    return as_requested(tracked, outside=outside, partially_outside=behaviour.poses_partially_out)


def port_status(port: Port, tracked: TrackedTool | None) -> int:
    """Return the port status, including the frame-dependent bits."""
    return port.status.value | (tracked.volume_status.value if tracked is not None else 0)


def information(tracked: TrackedTool | None) -> int:
    """Return the tool information byte."""
    return int(ToolInformation.TOO_FEW_MARKERS) if tracked is None else tracked.information


def marker_digits(tracked: TrackedTool | None, *, first_first: bool) -> str:
    """Return all 20 marker status digits."""
    digits = "" if tracked is None else "".join(map(str, tracked.marker_digits))
    digits = digits.ljust(wire.MARKER_DIGITS, "0")
    return digits if first_first else digits[::-1]


def list_markers(tracked: TrackedTool | None) -> Markers:
    """Return each measured marker's position and whether it is inside the volume."""
    if tracked is None:
        return []
    pairs = zip(tracked.markers_mm, tracked.markers_inside, strict=True)
    return [(position, inside) for position, inside in pairs if position is not None]


def _select_strays(strays: tuple[Stray, ...], options: int) -> tuple[Markers, list[Point]]:
    """Return all strays, and the positions to send: only those in the volume unless option 0800 is set."""
    whole = bool(options & OUT_OF_VOLUME)
    markers = [(stray.position_mm, stray.inside) for stray in strays]
    return markers, [position for position, inside in markers if inside or whole]
