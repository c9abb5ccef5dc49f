"""TX and BX: one frame as text and as bytes.

Options are those of `ronna_hw.wire.polaris.ReplyOption`; both forms tell the same frame.
"""

from __future__ import annotations

import struct

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HandleStatus, PortStatus, ReplyOption
from sim.polaris.measurement import Frame, Stray
from sim.polaris.ports import Port
from sim.polaris.profile import Profile
from sim.polaris.tracking_rules import ToolPose, Tracked

HEX_DIGIT_BITS = 4
MARKER_DIGITS = 20  # option 0002 always tells as many
TX_LARGEST_POSITION = 999_999
TX_LARGEST_ERROR = 99_999

_bx_handle = struct.Struct("<BB")
_bx_pose = struct.Struct("<8f")
_bx_status = struct.Struct("<II")  # port status, frame number
_bx_point = struct.Struct("<3f")
_u16 = struct.Struct("<H")


def text_reply(frame: Frame, options: ReplyOption, profile: Profile) -> str:
    """The answer to TX, without its CRC."""
    parts = [f"{len(frame.tools):02X}"]
    for port, tracked in frame.tools:
        parts.append(f"{port.handle:02X}")
        if options & ReplyOption.TRANSFORMS:
            pose = _reported_pose(tracked, options, profile)
            parts.append(wire.REPLY_MISSING if pose is None else _pose_text(pose))
            parts.append(f"{_port_status(port, tracked):08X}{frame.number & 0xFFFFFFFF:08X}")
        if options & ReplyOption.TOOL_INFORMATION:
            digits = _marker_digits(tracked, first_first=profile.first_marker_is_first_digit)
            parts.append(f"{_information(tracked):02X}{digits}")
        parts.append(wire.LF)
    if options & ReplyOption.STRAY_PASSIVE:
        parts.append(_strays_text(frame.strays, options, profile))
    parts.append(f"{int(frame.system_status):04X}")
    return "".join(parts)


def binary_body(frame: Frame, options: ReplyOption, profile: Profile) -> bytes:
    """The body of the answer to BX."""
    parts = [bytes([len(frame.tools)])]
    for port, tracked in frame.tools:
        pose = _reported_pose(tracked, options, profile)
        found = HandleStatus.MISSING if pose is None else HandleStatus.VALID
        parts.append(_bx_handle.pack(port.handle, found))
        if options & ReplyOption.TRANSFORMS:
            if pose is not None:
                parts.append(_bx_pose.pack(*pose.quaternion, *pose.position_mm, pose.error_mm))
            parts.append(_bx_status.pack(_port_status(port, tracked), frame.number & 0xFFFFFFFF))
        if options & ReplyOption.TOOL_INFORMATION:
            digits = _marker_digits(tracked, first_first=profile.first_marker_is_first_nibble)
            parts.append(bytes([_information(tracked)]) + bytes.fromhex(digits))
    if options & ReplyOption.STRAY_PASSIVE:
        parts.append(_strays_bytes(frame.strays, options))
    parts.append(_u16.pack(frame.system_status))
    return b"".join(parts)


def _reported_pose(tracked: Tracked | None, options: ReplyOption, profile: Profile) -> ToolPose | None:
    if tracked is None or tracked.pose is None or options & ReplyOption.OUT_OF_VOLUME:
        return None if tracked is None else tracked.pose
    if tracked.volume_status & PortStatus.OUT_OF_VOLUME:
        return None
    if tracked.volume_status & PortStatus.PARTIALLY_OUT_OF_VOLUME and not profile.poses_partially_out:
        return None
    return tracked.pose


def _port_status(port: Port, tracked: Tracked | None) -> int:
    return int(port.status | (tracked.volume_status if tracked is not None else PortStatus(0)))


def _information(tracked: Tracked | None) -> int:
    return int(wire.ToolInformation.TOO_FEW_MARKERS) if tracked is None else tracked.information


def _marker_digits(tracked: Tracked | None, *, first_first: bool) -> str:
    digits = "" if tracked is None else "".join(map(str, tracked.marker_digits))
    digits = digits.ljust(MARKER_DIGITS, "0")
    return digits if first_first else digits[::-1]


def _pose_text(pose: ToolPose) -> str:
    scale = wire.TX_QUATERNION_SCALE
    quaternion = "".join(f"{round(value * scale):+06d}" for value in pose.quaternion)
    error = min(round(pose.error_mm * wire.TX_ERROR_SCALE), TX_LARGEST_ERROR)
    return f"{quaternion}{_position_text(pose.position_mm)}{error:+06d}"


def _position_text(position_mm: tuple[float, float, float]) -> str:
    limit = TX_LARGEST_POSITION
    scaled = (round(value * wire.TX_POSITION_SCALE) for value in position_mm)
    return "".join(f"{max(-limit, min(limit, value)):+07d}" for value in scaled)


def _strays_text(strays: tuple[Stray, ...], options: ReplyOption, profile: Profile) -> str:
    count = len(strays)
    bits = 0
    for k, stray in enumerate(strays):
        if not stray.inside:
            bits |= 1 << (count - 1 - k if profile.first_stray_is_high_bit else k)
    digits = -(-count // HEX_DIGIT_BITS)
    out = f"{bits:0{digits}X}" if count else ""
    return f"{count:02X}{out}" + "".join(_position_text(s.position_mm) for s in _told(strays, options))


def _strays_bytes(strays: tuple[Stray, ...], options: ReplyOption) -> bytes:
    bits = sum(1 << k for k, stray in enumerate(strays) if not stray.inside)
    flags = bits.to_bytes(-(-len(strays) // 8), "little")
    points = b"".join(_bx_point.pack(*s.position_mm) for s in _told(strays, options))
    return bytes([len(strays)]) + flags + points


def _told(strays: tuple[Stray, ...], options: ReplyOption) -> tuple[Stray, ...]:
    """Count and bits cover all strays, positions only those inside unless 0800 asks for all."""
    if options & ReplyOption.OUT_OF_VOLUME:
        return strays
    return tuple(stray for stray in strays if stray.inside)
