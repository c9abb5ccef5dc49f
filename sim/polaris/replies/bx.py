"""The body of BX: one frame as bytes, little endian.

Options as in `ronna_hw.wire.polaris.ReplyOption`; the content is that of TX for the same frame.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from ronna_hw.wire.polaris import HandleStatus, ReplyOption
from sim.polaris.measurement.frame import Frame, Stray
from sim.polaris.measurement.tracking_rules import Tracked
from sim.polaris.replies.contents import (
    information,
    marker_digits,
    port_status,
    reported_strays,
    reported_tool,
    seen_markers,
)
from sim.polaris.tools.ports import Port
from sim.polaris.unit.behaviour import UnitBehaviour

FRAME_NUMBER_MASK = 0xFFFFFFFF
NO_POSITION = bytes(12)
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))

_handle = struct.Struct("<BB")
_pose = struct.Struct("<8f")
_status = struct.Struct("<II")  # port status, frame number
_point = struct.Struct("<3f")
_u16 = struct.Struct("<H")


def binary_body(frame: Frame, options: ReplyOption, behaviour: UnitBehaviour) -> bytes:
    """The body of the reply to BX."""
    parts = [bytes([len(frame.tools)])]
    for port, tracked in frame.tools:
        if port.enabled and port.occupied:
            parts.extend(_tool(frame, port, tracked, options, behaviour))
        else:  # nothing more, whatever the options
            parts.append(_handle.pack(port.handle, HandleStatus.DISABLED))
    if options & ReplyOption.STRAY_PASSIVE:
        parts.append(_strays(frame.strays, options, behaviour))
    parts.append(_u16.pack(frame.system_status))
    return b"".join(parts)


def _tool(
    frame: Frame, port: Port, tracked: Tracked | None, options: ReplyOption, behaviour: UnitBehaviour
) -> list[bytes]:
    tracked = reported_tool(tracked, options, behaviour)
    pose = None if tracked is None else tracked.pose
    parts = [_handle.pack(port.handle, HandleStatus.MISSING if pose is None else HandleStatus.VALID)]
    if options & ReplyOption.TRANSFORMS:
        if pose is not None:
            parts.append(_pose.pack(*pose.quaternion, *pose.position_mm, pose.error_mm))
        parts.append(_status.pack(port_status(port, tracked), frame.number & FRAME_NUMBER_MASK))
    if options & ReplyOption.TOOL_INFORMATION:
        digits = marker_digits(tracked, first_first=behaviour.first_marker_is_first_nibble)
        parts.append(bytes([information(tracked)]) + bytes.fromhex(digits))
    if options & ReplyOption.STRAY_ACTIVE:  # no tool of this unit has a stray active marker
        always = behaviour.binary_active_stray_always
        parts.append(bytes([HandleStatus.MISSING]) + NO_POSITION if always else b"\0")
    if options & ReplyOption.TOOL_MARKERS:
        markers = seen_markers(tracked)
        points = b"".join(_point.pack(*position) for position, _ in markers)
        parts.append(bytes([len(markers)]) + _bits([not inside for _, inside in markers], behaviour) + points)
    return parts


def _strays(strays: tuple[Stray, ...], options: ReplyOption, behaviour: UnitBehaviour) -> bytes:
    points = b"".join(_point.pack(*stray.position_mm) for stray in reported_strays(strays, options))
    return bytes([len(strays)]) + _bits([not stray.inside for stray in strays], behaviour) + points


def _bits(flags: Sequence[bool], behaviour: UnitBehaviour) -> bytes:
    """Flags as bits, eight to a byte."""
    content = sum(1 << k for k, flag in enumerate(flags) if flag).to_bytes(-(-len(flags) // 8), "little")
    return content if behaviour.first_stray_is_low_bit else content.translate(MIRRORED)
