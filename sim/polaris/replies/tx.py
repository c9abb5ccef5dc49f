"""TX: one frame as text. Options are those of `ronna_hw.wire.polaris.ReplyOption`."""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HandleStatus, ReplyOption
from sim.polaris.measurement.frame import Frame, Stray
from sim.polaris.measurement.tracking_rules import ToolPose, Tracked
from sim.polaris.replies.contents import (
    Point,
    information,
    marker_digits,
    port_status,
    reported_strays,
    reported_tool,
    seen_markers,
)
from sim.polaris.tools.ports import Port
from sim.polaris.unit.behaviour import UnitBehaviour

HEX_DIGIT_BITS = 4
LARGEST_POSITION = 999_999
LARGEST_ERROR = 99_999
FRAME_NUMBER_MASK = 0xFFFFFFFF


def text_reply(frame: Frame, options: ReplyOption, behaviour: UnitBehaviour) -> str:
    """The reply to TX, without its CRC."""
    parts = [f"{len(frame.tools):02X}"]
    for port, tracked in frame.tools:
        parts.append(f"{port.handle:02X}")
        if port.enabled and port.occupied:
            parts.extend(_tool(frame, port, tracked, options, behaviour))
        else:
            parts.append(wire.REPLY_DISABLED if port.occupied else wire.REPLY_UNOCCUPIED)
            if behaviour.status_of_unseen_handles:
                parts.append(_status(frame, port, tracked))
        parts.append(wire.LF)
    if options & ReplyOption.STRAY_PASSIVE:
        parts.append(_strays(frame.strays, options, behaviour))
    parts.append(f"{int(frame.system_status):04X}")
    return "".join(parts)


def _tool(
    frame: Frame, port: Port, tracked: Tracked | None, options: ReplyOption, behaviour: UnitBehaviour
) -> list[str]:
    parts = []
    tracked = reported_tool(tracked, options, behaviour)
    if options & ReplyOption.TRANSFORMS:
        pose = None if tracked is None else tracked.pose
        parts.append(wire.REPLY_MISSING if pose is None else _pose(pose))
        parts.append(_status(frame, port, tracked))
    if options & ReplyOption.TOOL_INFORMATION:
        digits = marker_digits(tracked, first_first=behaviour.first_marker_is_first_digit)
        parts.append(f"{information(tracked):02X}{digits}")
    if options & ReplyOption.STRAY_ACTIVE:  # no tool of this unit has a stray active marker
        words = behaviour.text_active_stray == "words"
        parts.append(wire.REPLY_MISSING if words else f"{HandleStatus.MISSING:02X}")
    if options & ReplyOption.TOOL_MARKERS:
        markers = seen_markers(tracked)
        outside = [not inside for _, inside in markers]
        bits = _bits(outside, first_is_high=behaviour.first_stray_is_high_bit)
        parts.append(f"{len(markers):02X}{bits}" + "".join(_position(position) for position, _ in markers))
    return parts


def _status(frame: Frame, port: Port, tracked: Tracked | None) -> str:
    return f"{port_status(port, tracked):08X}{frame.number & FRAME_NUMBER_MASK:08X}"


def _pose(pose: ToolPose) -> str:
    quaternion = "".join(f"{round(value * wire.TX_QUATERNION_SCALE):+06d}" for value in pose.quaternion)
    error = min(round(pose.error_mm * wire.TX_ERROR_SCALE), LARGEST_ERROR)
    return f"{quaternion}{_position(pose.position_mm)}{error:+06d}"


def _position(position_mm: Point) -> str:
    scaled = (round(value * wire.TX_POSITION_SCALE) for value in position_mm)
    return "".join(f"{max(-LARGEST_POSITION, min(LARGEST_POSITION, value)):+07d}" for value in scaled)


def _strays(strays: tuple[Stray, ...], options: ReplyOption, behaviour: UnitBehaviour) -> str:
    outside = [not stray.inside for stray in strays]
    bits = _bits(outside, first_is_high=behaviour.first_stray_is_high_bit)
    positions = "".join(_position(stray.position_mm) for stray in reported_strays(strays, options))
    return f"{len(strays):02X}{bits}{positions}"


def _bits(flags: Sequence[bool], *, first_is_high: bool) -> str:
    """The flags as hex digits: one number with flag 0 highest, or four flags per digit in order."""
    digits = -(-len(flags) // HEX_DIGIT_BITS)
    if not digits:
        return ""
    if first_is_high:
        number = sum(1 << (len(flags) - 1 - k) for k, flag in enumerate(flags) if flag)
        return f"{number:0{digits}X}"
    groups = [flags[k : k + HEX_DIGIT_BITS] for k in range(0, len(flags), HEX_DIGIT_BITS)]
    return "".join(f"{sum(1 << k for k, flag in enumerate(group) if flag):X}" for group in groups)
