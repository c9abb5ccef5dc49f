"""From a reply to readings: tool names, validities, and strays that belong to no tool."""

from __future__ import annotations

import math

from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.tools.loading import LoadedTool
from drivers.ndi_polaris.tracking.reply import HandleReport, TrackingReply
from drivers.ndi_polaris.unit.measuring_volume import MeasuringVolume
from drivers.ndi_polaris.unit.system_status import DOUBTFUL_STATUS
from ronna_hw.devices.readings import (
    Quaternion,
    Stamp,
    StrayReading,
    ToolReading,
    TrackerFrame,
    Validity,
    Vector3,
)
from ronna_hw.wire.polaris import PortStatus

NORM_TOLERANCE = 1e-2  # rounding in TX changes the norm by 1e-4; beyond this it is not a rotation
FARTHEST_MM = 9999.99  # limit of the unit's text format
DISTURBED = 0x7F00  # every bit above the low byte reports a disturbed measurement
REMARKABLE_PORT_STATUS = int(PortStatus.OUT_OF_VOLUME | PortStatus.PARTIALLY_OUT_OF_VOLUME) | DISTURBED


def frame_number(reply: TrackingReply) -> int:
    """Frame number of the reply; raises NDI-006 when no handle carries one."""
    number: int | None = None
    for report in reply.handles:
        if report.frame is not None and (number is None or report.frame > number):
            number = report.frame
    if number is None:
        raise MalformedReply("no handle of the reply carries a frame number")
    return number


def assemble(
    reply: TrackingReply,
    tools: tuple[LoadedTool, ...],
    *,
    frame: int,
    stamp: Stamp,
    repeated: bool,
    volume: MeasuringVolume | None,
    stray_to_marker_mm: float,
) -> TrackerFrame:
    """One frame of readings; STALE for a repeated frame, PARTIAL for a doubtful system status.

    `frame` is the frame number of the reply.
    """
    reports = {report.handle: report for report in reply.handles}
    readings = []
    seen = []
    for tool in tools:
        if tool.name is None or tool.definition is None:
            continue
        reading = _tool_reading(tool.name, reports.get(tool.handle), frame)
        readings.append(reading)
        if reading.rotation is not None:
            seen.append((tool, reading))
    if repeated:
        validity = Validity.STALE
    else:
        validity = Validity.PARTIAL if reply.system_status & DOUBTFUL_STATUS else Validity.OK
    strays = _strays(reply, seen, volume, stray_to_marker_mm) if reply.strays_mm else ()
    return TrackerFrame(stamp, validity, tuple(readings), strays)


def _tool_reading(name: str, report: HandleReport | None, frame: int) -> ToolReading:
    if report is None or report.rotation is None or report.position_mm is None:
        outside = report is not None and report.port_status & PortStatus.OUT_OF_VOLUME.value
        return ToolReading(name, Validity.OUT_OF_VOLUME if outside else Validity.MISSING, None, None, None)
    rotation = _unit(report.rotation)
    if rotation is None or not _sane(report.position_mm) or not _sane_error(report.fit_error_mm):
        return ToolReading(name, Validity.CORRUPT, None, None, None)
    return ToolReading(name, _validity(report, frame), rotation, report.position_mm, report.fit_error_mm)


def _validity(report: HandleReport, frame: int) -> Validity:
    if report.frame != frame:
        return Validity.STALE
    if not report.port_status & REMARKABLE_PORT_STATUS:
        return Validity.OK
    outside = report.port_status & PortStatus.OUT_OF_VOLUME.value
    return Validity.OUT_OF_VOLUME if outside else Validity.PARTIAL


def _strays(
    reply: TrackingReply,
    seen: list[tuple[LoadedTool, ToolReading]],
    volume: MeasuringVolume | None,
    nearest_mm: float,
) -> tuple[StrayReading, ...]:
    strays = []
    for index, position in enumerate(reply.strays_mm):
        if not _sane(position):
            continue  # a stray is only a position
        if any(_is_marker_of(tool, reading, position, nearest_mm) for tool, reading in seen):
            continue
        inside = volume.contains(position) if volume is not None else None
        if inside is None:  # unknown volume: rely on the unit's own bit
            inside = reply.stray_outside is None or not reply.stray_outside[index]
        strays.append(StrayReading(position, Validity.OK if inside else Validity.OUT_OF_VOLUME))
    return tuple(strays)


def _is_marker_of(tool: LoadedTool, reading: ToolReading, position: Vector3, nearest_mm: float) -> bool:
    """Whether the stray is one of the tool's own markers."""
    assert tool.definition is not None
    assert reading.rotation is not None
    assert reading.position_mm is not None
    if math.dist(position, reading.position_mm) > tool.radius_mm + nearest_mm:
        return False
    placed = _placed(tool.definition.markers_mm, reading.rotation, reading.position_mm)
    return any(math.dist(position, marker) < nearest_mm for marker in placed)


def _unit(rotation: Quaternion) -> Quaternion | None:
    """The quaternion normalised, scalar part >= 0; None if it is not a rotation."""
    q0, qx, qy, qz = rotation
    norm = math.sqrt(q0 * q0 + qx * qx + qy * qy + qz * qz)
    if not abs(norm - 1.0) <= NORM_TOLERANCE:  # also rejects NaN
        return None
    scale = -1.0 / norm if q0 < 0 else 1.0 / norm
    return q0 * scale, qx * scale, qy * scale, qz * scale


def _sane(position_mm: Vector3) -> bool:
    x, y, z = position_mm
    return abs(x) <= FARTHEST_MM and abs(y) <= FARTHEST_MM and -FARTHEST_MM <= z < 0


def _sane_error(error_mm: float | None) -> bool:
    return error_mm is not None and 0 <= error_mm <= FARTHEST_MM


def _placed(markers_mm: tuple[Vector3, ...], rotation: Quaternion, position_mm: Vector3) -> list[Vector3]:
    """Marker positions in tracker coordinates: v + 2 w (u x v) + 2 u x (u x v) + t for q = (w, u)."""
    w, ux, uy, uz = rotation
    tx, ty, tz = position_mm
    placed = []
    for x, y, z in markers_mm:
        cx, cy, cz = uy * z - uz * y, uz * x - ux * z, ux * y - uy * x
        placed.append(
            (
                x + 2 * (w * cx + uy * cz - uz * cy) + tx,
                y + 2 * (w * cy + uz * cx - ux * cz) + ty,
                z + 2 * (w * cz + ux * cy - uy * cx) + tz,
            )
        )
    return placed
