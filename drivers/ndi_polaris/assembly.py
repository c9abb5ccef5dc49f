"""From the unit's reply to readings: names for handles, validities, and strays that are really strays."""

from __future__ import annotations

import math
from collections.abc import Iterable

from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.setup import LoadedTool
from drivers.ndi_polaris.status import DOUBTFUL_STATUS
from drivers.ndi_polaris.tracking_reply import HandleReport, HandleState, TrackingReply
from drivers.ndi_polaris.volume import MeasuringVolume
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

NORM_TOLERANCE = 1e-2  # rounding in TX moves the norm by 1e-4; more than this is no rotation
FARTHEST_MM = 9999.99  # what the unit's own text format can say


def frame_number(reply: TrackingReply) -> int:
    """Number of the frame that the reply belongs to; raises NDI-006 when no handle carries one."""
    numbers = [report.frame for report in reply.handles if report.frame is not None]
    if not numbers:
        raise MalformedReply("no handle of the reply carries a frame number")
    return max(numbers)


def assemble(
    reply: TrackingReply,
    tools: tuple[LoadedTool, ...],
    *,
    stamp: Stamp,
    repeated: bool,
    volume: MeasuringVolume | None,
    stray_to_marker_mm: float,
) -> TrackerFrame:
    """One frame of readings. A repeated frame number is STALE, a doubtful system status PARTIAL."""
    reports = {report.handle: report for report in reply.handles}
    readings = []
    markers_mm: list[Vector3] = []
    for tool in tools:
        if tool.name is None or tool.definition is None:
            continue
        reading = _tool_reading(tool.name, reports.get(tool.handle), stamp.device_clock)
        readings.append(reading)
        if reading.rotation is not None and reading.position_mm is not None:
            markers_mm += _placed(tool.definition.markers_mm, reading.rotation, reading.position_mm)
    validity = Validity.PARTIAL if reply.system_status & DOUBTFUL_STATUS else Validity.OK
    return TrackerFrame(
        stamp=stamp,
        validity=Validity.STALE if repeated else validity,
        tools=tuple(readings),
        strays=tuple(_strays(reply, markers_mm, volume, stray_to_marker_mm)),
    )


def _tool_reading(name: str, report: HandleReport | None, frame: int) -> ToolReading:
    if report is None or report.rotation is None or report.position_mm is None:
        outside = report is not None and PortStatus.OUT_OF_VOLUME in report.port_status
        return ToolReading(name, Validity.OUT_OF_VOLUME if outside else Validity.MISSING, None, None, None)
    rotation = _unit(report.rotation)
    if rotation is None or not _sane(report.position_mm) or not _sane_error(report.fit_error_mm):
        return ToolReading(name, Validity.CORRUPT, None, None, None)
    return ToolReading(name, _validity(report, frame), rotation, report.position_mm, report.fit_error_mm)


def _validity(report: HandleReport, frame: int) -> Validity:
    if report.state is not HandleState.VALID:
        return Validity.MISSING
    if report.frame != frame:
        return Validity.STALE
    if PortStatus.OUT_OF_VOLUME in report.port_status:
        return Validity.OUT_OF_VOLUME
    doubtful = (
        PortStatus.PARTIALLY_OUT_OF_VOLUME | PortStatus.IR_INTERFERENCE | PortStatus.PROCESSING_EXCEPTION
    )
    return Validity.PARTIAL if report.port_status & doubtful else Validity.OK


def _strays(
    reply: TrackingReply, markers_mm: list[Vector3], volume: MeasuringVolume | None, nearest_mm: float
) -> Iterable[StrayReading]:
    for index, position in enumerate(reply.strays_mm):
        if not _sane(position):
            continue  # no place, no reading: a stray is nothing but its place
        if any(math.dist(position, marker) < nearest_mm for marker in markers_mm):
            continue
        inside = volume.contains(position) if volume is not None else None
        if inside is None:  # the volume is not known: the unit's own word has to do
            inside = reply.stray_outside is None or not reply.stray_outside[index]
        yield StrayReading(position, Validity.OK if inside else Validity.OUT_OF_VOLUME)


def _unit(rotation: Quaternion) -> Quaternion | None:
    """The quaternion with norm 1 and a scalar part that is not negative; None when it is no rotation."""
    norm = math.sqrt(sum(value * value for value in rotation))
    if not abs(norm - 1.0) <= NORM_TOLERANCE:  # also true for NaN
        return None
    scale = -1.0 / norm if rotation[0] < 0 else 1.0 / norm
    q0, qx, qy, qz = rotation
    return q0 * scale, qx * scale, qy * scale, qz * scale


def _sane(position_mm: Vector3) -> bool:
    return all(abs(value) <= FARTHEST_MM for value in position_mm) and position_mm[2] < 0


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
