"""Rules for deriving a tool's pose from measured markers, or the reason why it has none.

In the unit's order: choose the face, fit at least three markers, drop markers beyond the maximum angle, out
of the volume or beyond the maximum 3D error, test the spread of the rest. Enough markers must remain
after each step. A reply reports a tool outside the volume only if requested: `as_requested`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan2, cos, degrees, radians, sqrt
from typing import NamedTuple

import numpy as np

from ronna_hw.wire.polaris import MarkerState, PortStatus, ToolInformation
from sim.polaris.unit.ports import ALL_FACES
from sim.polaris.unit.tool_definition import ToolDefinition
from sim.world.rigid import Vectors, quaternion_from_rotation

LEAST_TO_FIT = 3
HYSTERESIS_DEG = 2.0  # by which another face must be turned more directly to the sensor
ONLY_FACE = 1

DROPPED_OUT_OF_VOLUME = 4  # marker digits of newer firmware; undocumented for older
USED_OUT_OF_VOLUME = 5
FACE_BITS = 4  # position of the face number in the tool information
FACE_MASK = 0x07 << FACE_BITS
INFRARED_COPY = 0x04  # copy of the interference bit in the tool information; its position is not public
WITHIN = PortStatus(0)
OUTSIDE = PortStatus.OUT_OF_VOLUME | PortStatus.PARTIALLY_OUT_OF_VOLUME


@dataclass(frozen=True)
class ToolPose:
    """Pose tracker <- tool (scalar-first quaternion) and rms distance of the fitted markers."""

    quaternion: tuple[float, float, float, float]
    position_mm: tuple[float, float, float]
    error_mm: float


@dataclass(frozen=True)
class TrackedTool:
    """Result for one tool in one frame, regardless of whether it is inside the volume."""

    pose: ToolPose | None
    volume_status: PortStatus  # bits that the frame adds to the port status
    information: int
    marker_digits: tuple[int, ...]  # one per marker of the definition
    face: int = ONLY_FACE
    seen: tuple[int, ...] = ()  # indices of the measured markers
    measured_mm: tuple[tuple[float, float, float], ...] = ()  # their positions, in the same order
    inside: tuple[bool, ...] = ()  # whether each is inside the volume

    @property
    def markers_mm(self) -> tuple[tuple[float, float, float] | None, ...]:
        """Measured position of each marker in the definition, or None for an unseen marker."""
        places = dict(zip(self.seen, self.measured_mm, strict=True))
        return tuple(places.get(number) for number in range(len(self.marker_digits)))

    @property
    def markers_inside(self) -> tuple[bool, ...]:
        """Whether each marker in the definition was measured inside the volume."""
        within = dict(zip(self.seen, self.inside, strict=True))
        return tuple(within.get(number, False) for number in range(len(self.marker_digits)))


def track(
    definition: ToolDefinition,
    seen: list[int],
    measured_mm: Vectors,
    inside: list[bool],
    previous_face: int = 0,
    allowed_faces: int = ALL_FACES,
) -> TrackedTool:
    """Apply the tracking rules, with `seen` as the marker indices of the rows of `measured_mm` (n, 3)."""
    judge = _Judge(definition, seen, measured_mm, inside)
    return judge.tracked(
        best_face(definition, seen, measured_mm, previous_face, allowed_faces), previous_face
    )


def as_requested(tracked: TrackedTool, *, outside: bool, partially_outside: bool) -> TrackedTool:
    """Return the result, hiding the pose of an out-of-volume tool unless it was requested.

    `outside`: such tools were requested. `partially_outside`: the unit reports them unrequested if some
    markers, but fewer than the minimum, are inside.
    """
    hidden = PortStatus.OUT_OF_VOLUME if partially_outside else OUTSIDE
    if outside or not tracked.volume_status & hidden:
        return tracked
    digits = tuple(
        DROPPED_OUT_OF_VOLUME if digit == USED_OUT_OF_VOLUME else digit for digit in tracked.marker_digits
    )
    information = tracked.information & ~FACE_MASK | ToolInformation.TOO_FEW_MARKERS  # no face is used
    return replace(tracked, pose=None, information=int(information), marker_digits=digits)


class _Judge:
    """Applies the rules to one tool in one frame and records each marker's status digit."""

    def __init__(
        self, definition: ToolDefinition, seen: list[int], measured_mm: Vectors, inside: list[bool]
    ) -> None:
        self._definition = definition
        self._seen = seen
        self._measured_mm = measured_mm
        self._inside = inside
        self._digits = [int(MarkerState.MISSING)] * len(definition.markers_mm)

    def tracked(self, chosen: FittedFace | None, previous_face: int) -> TrackedTool:
        definition = self._definition
        if chosen is None:
            status = _volume_status(self._inside, definition)
            return self._build_verdict(None, status, ToolInformation.TOO_FEW_MARKERS, previous_face)
        fit, markers, rows = chosen.fit, chosen.markers, chosen.rows
        measured = self._measured_mm if len(rows) == len(self._seen) else self._measured_mm[rows]
        within = [self._inside[row] for row in rows]

        normals = definition.normals[markers] @ fit.rotation.T
        facing = _find_facing(normals, measured, definition.maximum_angle_deg)
        used = self._keep(list(range(len(markers))), facing, markers, MarkerState.BEYOND_ANGLE)
        status = _volume_status([within[k] for k in used], definition)
        if sum(within[k] for k in used) >= definition.minimum_markers:
            used = self._keep(used, within, markers, DROPPED_OUT_OF_VOLUME)
        if len(used) < definition.minimum_markers:
            return self._build_verdict(None, status, ToolInformation.TOO_FEW_MARKERS, chosen.face)

        body = definition.markers_mm[markers]
        if len(used) < len(markers):
            fit = fit_rigid_body(body[used], measured[used])
        near = [False] * len(markers)
        for k, distance in zip(used, fit.distances_mm.tolist(), strict=True):
            near[k] = distance <= definition.maximum_error_mm
        good = self._keep(used, near, markers, MarkerState.BEYOND_ERROR)
        if len(good) < definition.minimum_markers or not _is_spread_enough(body[good], definition):
            return self._build_verdict(None, status, ToolInformation.BAD_FIT, chosen.face)
        if len(good) < len(used):
            fit = fit_rigid_body(body[good], measured[good])
        for k in good:
            self._digits[markers[k]] = int(MarkerState.USED) if within[k] else USED_OUT_OF_VOLUME
        return self._build_verdict(_as_tool_pose(fit), status, chosen.face << FACE_BITS, chosen.face)

    def _keep(self, numbers: list[int], keep: list[bool], markers: list[int], digit: int) -> list[int]:
        """Keep the markers that pass a rule, and assign the rule's digit to the others."""
        for k in numbers:
            if not keep[k]:
                self._digits[markers[k]] = int(digit)
        return [k for k in numbers if keep[k]]

    def _build_verdict(
        self, pose: ToolPose | None, status: PortStatus, information: int, face: int
    ) -> TrackedTool:
        points = tuple((x, y, z) for x, y, z in self._measured_mm.tolist())
        seen, inside = tuple(self._seen), tuple(self._inside)
        return TrackedTool(pose, status, int(information), tuple(self._digits), face, seen, points, inside)


def _find_facing(normals: Vectors, markers_mm: Vectors, maximum_angle_deg: float) -> list[bool]:
    """Return whether each marker faces the sensor (the origin) within the maximum angle."""
    towards = -(normals * markers_mm).sum(axis=1)
    limit = cos(radians(maximum_angle_deg)) * np.sqrt((markers_mm * markers_mm).sum(axis=1))
    facing: list[bool] = (towards >= limit).tolist()
    return facing


def _volume_status(inside: list[bool], definition: ToolDefinition) -> PortStatus:
    """Return the volume status: out if every marker is outside, partially out if too few are inside."""
    count = sum(inside)
    if count == len(inside) or count >= definition.minimum_markers:
        return WITHIN
    return PortStatus.PARTIALLY_OUT_OF_VOLUME if count else PortStatus.OUT_OF_VOLUME


def _is_spread_enough(body_mm: Vectors, definition: ToolDefinition) -> bool:
    """Return whether the used markers spread far enough along each of their principal axes.

    NDI's measure is not public; this one is the distance between the outermost markers.
    """
    if not any(definition.minimum_spread_mm):
        return True
    centred = body_mm - body_mm.mean(axis=0)
    extents = np.sort(np.ptp(centred @ np.linalg.svd(centred)[2].T, axis=0))[::-1]
    return bool((extents >= np.array(definition.minimum_spread_mm)).all())


def _as_tool_pose(fit: MarkerFit) -> ToolPose:
    w, qx, qy, qz = quaternion_from_rotation(fit.rotation).tolist()
    x, y, z = fit.translation_mm.tolist()
    squares = fit.distances_mm**2
    return ToolPose((w, qx, qy, qz), (x, y, z), sqrt(float(squares.sum()) / len(squares)))


@dataclass(frozen=True)
class FittedFace:
    """Visible markers of one face: indices, measurement rows and fit."""

    face: int
    markers: list[int]
    rows: list[int]
    fit: MarkerFit


def best_face(
    definition: ToolDefinition,
    seen: list[int],
    measured_mm: Vectors,
    previous: int = 0,
    allowed: int = ALL_FACES,
) -> FittedFace | None:
    """Choose the face to track, or return None if no face has enough visible markers for a fit.

    The face turned most directly to the sensor, with hysteresis in favour of `previous`, the face of the last
    frame. `seen` as in `track`; `allowed` has one bit per face that may be tracked, lowest bit for face 1.
    """
    faces = [face for face in definition.different_faces or (ONLY_FACE,) if allowed >> (face - 1) & 1]
    if len(faces) == 1:
        return _fit(definition, faces[0], seen, measured_mm)
    candidates: dict[int, tuple[float, FittedFace]] = {}
    for face in faces:
        fitted = _fit(definition, face, seen, measured_mm)
        if fitted is not None:
            candidates[face] = (_angle_to_sensor_deg(definition, fitted), fitted)
    if not candidates:
        return None
    best_deg, best = min(candidates.values(), key=lambda candidate: candidate[0])
    if previous in candidates and candidates[previous][0] <= best_deg + HYSTERESIS_DEG:
        return candidates[previous][1]
    return best


def _fit(definition: ToolDefinition, face: int, seen: list[int], measured_mm: Vectors) -> FittedFace | None:
    faces = definition.faces
    rows = [row for row, marker in enumerate(seen) if not faces or faces[marker] == face]
    if len(rows) < LEAST_TO_FIT:
        return None
    markers = [seen[row] for row in rows]
    return FittedFace(face, markers, rows, fit_rigid_body(definition.markers_mm[markers], measured_mm[rows]))


def _angle_to_sensor_deg(definition: ToolDefinition, fitted: FittedFace) -> float:
    """Return the angle between a face's normal and the direction to the sensor (the origin).

    0 if the normals cancel out, as with markers back to back: such a face is seen from all around.
    """
    members = [marker for marker, face in enumerate(definition.faces) if face == fitted.face]
    normal = fitted.fit.rotation @ definition.normals[members].mean(axis=0)
    towards = -(fitted.fit.rotation @ definition.markers_mm[members].mean(axis=0) + fitted.fit.translation_mm)
    return degrees(atan2(float(np.linalg.norm(np.cross(normal, towards))), float(normal @ towards)))


class MarkerFit(NamedTuple):
    """Fitted pose tracker <- tool: rotation (3, 3), translation (3,) and marker residuals (n,)."""

    rotation: Vectors
    translation_mm: Vectors
    distances_mm: Vectors


def fit_rigid_body(body_mm: Vectors, measured_mm: Vectors) -> MarkerFit:
    """Fit markers (n, 3), n >= 3, to their measured positions (n, 3), paired by row.

    Orthogonal Procrustes by SVD (Arun 1987) with Umeyama's sign, so that a mirror image is never returned.
    """
    count = len(body_mm)
    body_centre = body_mm.sum(axis=0) / count
    measured_centre = measured_mm.sum(axis=0) / count
    left, _, right = np.linalg.svd((measured_mm - measured_centre).T @ (body_mm - body_centre))
    rotation: Vectors = left @ right
    if _determinant(rotation.tolist()) < 0.0:
        left[:, 2] = -left[:, 2]
        rotation = left @ right
    translation = measured_centre - rotation @ body_centre
    residuals = body_mm @ rotation.T + translation - measured_mm
    return MarkerFit(rotation, translation, np.sqrt((residuals * residuals).sum(axis=1)))


def _determinant(matrix: list[list[float]]) -> float:
    """Return the determinant of a (3, 3) matrix, ten times as fast as `numpy.linalg.det`."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
