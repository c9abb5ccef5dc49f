"""From the measured markers of one tool to its pose, or to the reason why there is none.

The order is the unit's: fit with at least three markers, drop markers beyond the maximum angle, drop those
out of the volume, drop those beyond the maximum 3D error; after each step enough of them must be left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, radians

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.polaris import MarkerState, PortStatus, ToolInformation
from sim.polaris.definition import ToolDefinition
from sim.polaris.fit import fit_body
from sim.theatre.rigid import quaternion_from_rotation

Vectors = NDArray[np.float64]

LEAST_TO_FIT = 3
DROPPED_OUT_OF_VOLUME = 4  # marker digits of newer firmware; older papers do not tell
USED_OUT_OF_VOLUME = 5
FACE_BITS = 4  # position of the face number in the tool information
ONLY_FACE = 1


@dataclass(frozen=True)
class ToolPose:
    """Pose tracker <- tool: scalar-first quaternion, mm, and the rms distance of the fitted markers."""

    quaternion: tuple[float, float, float, float]
    position_mm: tuple[float, float, float]
    error_mm: float


@dataclass(frozen=True)
class Tracked:
    """What the unit found out about one tool in one frame."""

    pose: ToolPose | None
    volume_status: PortStatus  # only the two out-of-volume bits
    information: int
    marker_digits: tuple[int, ...]  # one per marker of the definition
    markers_mm: tuple[tuple[float, float, float] | None, ...] = ()  # likewise, where they were measured
    markers_inside: tuple[bool, ...] = ()  # likewise, within the volume


def track(definition: ToolDefinition, seen: list[int], measured_mm: Vectors, inside: list[bool]) -> Tracked:
    """Apply the rules. `seen` are the numbers of the markers in `measured_mm` (n, 3), in the same order."""
    positions: list[tuple[float, float, float] | None] = [None] * len(definition.markers_mm)
    within = [False] * len(definition.markers_mm)
    for number, (x, y, z), is_inside in zip(seen, measured_mm.tolist(), inside, strict=True):
        positions[number] = (x, y, z)
        within[number] = is_inside
    tracked = _judged(definition, seen, measured_mm, inside)
    return replace(tracked, markers_mm=tuple(positions), markers_inside=tuple(within))


def _judged(definition: ToolDefinition, seen: list[int], measured_mm: Vectors, inside: list[bool]) -> Tracked:
    digits = [int(MarkerState.MISSING)] * len(definition.markers_mm)
    used = list(range(len(seen)))
    if len(used) < LEAST_TO_FIT:
        return _lost(definition, digits, ToolInformation.TOO_FEW_MARKERS, _status(inside, definition))
    body = definition.markers_mm[seen]
    fit = fit_body(body, measured_mm)

    facing = _facing(definition.normals[seen] @ fit[0].T, measured_mm, definition.maximum_angle_deg)
    for k in used:
        if not facing[k]:
            digits[seen[k]] = int(MarkerState.BEYOND_ANGLE)
    used = [k for k in used if facing[k]]
    status = _status([inside[k] for k in used], definition)
    within = [k for k in used if inside[k]]
    if len(within) >= definition.minimum_markers:
        for k in used:
            if not inside[k]:
                digits[seen[k]] = DROPPED_OUT_OF_VOLUME
        used = within
    if len(used) < definition.minimum_markers:
        return _lost(definition, digits, ToolInformation.TOO_FEW_MARKERS, status)

    if len(used) < len(seen):
        fit = fit_body(body[used], measured_mm[used])
    limit_mm = definition.maximum_error_mm
    good = [k for k, distance in zip(used, fit[2].tolist(), strict=True) if distance <= limit_mm]
    if len(good) < len(used):
        for k in used:
            if k not in good:
                digits[seen[k]] = int(MarkerState.BEYOND_ERROR)
        if len(good) < definition.minimum_markers:
            return _lost(definition, digits, ToolInformation.BAD_FIT, status)
        fit = fit_body(body[good], measured_mm[good])
    for k in good:
        digits[seen[k]] = int(MarkerState.USED) if inside[k] else USED_OUT_OF_VOLUME
    rotation, translation, distances = fit
    w, qx, qy, qz = quaternion_from_rotation(rotation).tolist()
    x, y, z = translation.tolist()
    error_mm = float(np.sqrt(np.mean(distances**2)))
    pose = ToolPose((w, qx, qy, qz), (x, y, z), error_mm)
    return Tracked(pose, status, ONLY_FACE << FACE_BITS, tuple(digits))


def _facing(normals: Vectors, markers_mm: Vectors, maximum_angle_deg: float) -> list[bool]:
    """Which markers turn their face towards the sensor (the origin) within the angle."""
    towards = -(normals * markers_mm).sum(axis=1)
    limit = cos(radians(maximum_angle_deg)) * np.sqrt((markers_mm * markers_mm).sum(axis=1))
    facing: list[bool] = (towards >= limit).tolist()
    return facing


def _status(inside: list[bool], definition: ToolDefinition) -> PortStatus:
    """Out of the volume: every marker outside. Partially out: too few inside, because others are outside."""
    count = sum(inside)
    if count == len(inside) or count >= definition.minimum_markers:
        return PortStatus(0)
    return PortStatus.PARTIALLY_OUT_OF_VOLUME if count else PortStatus.OUT_OF_VOLUME


def _lost(definition: ToolDefinition, digits: list[int], why: int, status: PortStatus) -> Tracked:
    return Tracked(None, status, why, tuple(digits))
