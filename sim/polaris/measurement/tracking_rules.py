"""From one tool's measured markers to its pose, or to the reason why there is none.

In the unit's order: fit at least three markers, drop those beyond the maximum angle, out of the volume, and
beyond the maximum 3D error, then test the spread of the rest; enough markers must remain after each step.
What a reply may report about a tool outside the volume depends on the request: `as_asked` applies that rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, radians

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.polaris import MarkerState, PortStatus, ToolInformation
from sim.polaris.measurement.face_choice import ALL_FACES, ONLY_FACE, FittedFace, best_face
from sim.polaris.measurement.rigid_fit import RigidFit, fit_rigid_body
from sim.polaris.tools.definition import ToolDefinition
from sim.world.rigid import quaternion_from_rotation

Vectors = NDArray[np.float64]

DROPPED_OUT_OF_VOLUME = 4  # marker digits of newer firmware; undocumented for older
USED_OUT_OF_VOLUME = 5
FACE_BITS = 4  # position of the face number in the tool information
FACE_MASK = 0x07 << FACE_BITS
INFRARED_COPY = 0x04  # copy of the interference bit in the tool information; its position is not public
OUTSIDE = PortStatus.OUT_OF_VOLUME | PortStatus.PARTIALLY_OUT_OF_VOLUME


@dataclass(frozen=True)
class ToolPose:
    """Pose tracker <- tool: scalar-first quaternion, mm, and the rms distance of the fitted markers."""

    quaternion: tuple[float, float, float, float]
    position_mm: tuple[float, float, float]
    error_mm: float


@dataclass(frozen=True)
class Tracked:
    """The result for one tool in one frame, inside the volume or not."""

    pose: ToolPose | None
    volume_status: PortStatus  # bits that the frame adds to the port status
    information: int
    marker_digits: tuple[int, ...]  # one per marker of the definition
    face: int = ONLY_FACE
    seen: tuple[int, ...] = ()  # numbers of the measured markers
    measured_mm: tuple[tuple[float, float, float], ...] = ()  # their positions, in the same order
    inside: tuple[bool, ...] = ()  # whether each is inside the volume

    @property
    def markers_mm(self) -> tuple[tuple[float, float, float] | None, ...]:
        """Measured position of each marker of the definition; None if it was not seen."""
        places = dict(zip(self.seen, self.measured_mm, strict=True))
        return tuple(places.get(number) for number in range(len(self.marker_digits)))

    @property
    def markers_inside(self) -> tuple[bool, ...]:
        """Whether each marker of the definition was measured inside the volume."""
        within = dict(zip(self.seen, self.inside, strict=True))
        return tuple(within.get(number, False) for number in range(len(self.marker_digits)))


def track(
    definition: ToolDefinition,
    seen: list[int],
    measured_mm: Vectors,
    inside: list[bool],
    previous_face: int = 0,
    allowed_faces: int = ALL_FACES,
) -> Tracked:
    """Apply the rules. `seen` are the numbers of the markers in `measured_mm` (n, 3), in the same order."""
    judge = _Judge(definition, seen, measured_mm, inside)
    return judge.tracked(
        best_face(definition, seen, measured_mm, previous_face, allowed_faces), previous_face
    )


def as_asked(tracked: Tracked, *, outside: bool, partially_outside: bool) -> Tracked:
    """The tool as a reply reports it.

    `outside`: tools out of the volume were requested. `partially_outside`: the unit reports a tool
    unrequested if some markers, but fewer than the minimum, are inside.
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
    """Applies the rules to one tool in one frame and records the digit of each marker."""

    def __init__(
        self, definition: ToolDefinition, seen: list[int], measured_mm: Vectors, inside: list[bool]
    ) -> None:
        self._definition = definition
        self._seen = seen
        self._measured_mm = measured_mm
        self._inside = inside
        self._digits = [int(MarkerState.MISSING)] * len(definition.markers_mm)

    def tracked(self, chosen: FittedFace | None, previous_face: int) -> Tracked:
        definition = self._definition
        if chosen is None:
            status = _status(self._inside, definition)
            return self._verdict(None, status, ToolInformation.TOO_FEW_MARKERS, previous_face)
        fit, markers, rows = chosen.fit, chosen.markers, chosen.rows
        measured = self._measured_mm if len(rows) == len(self._seen) else self._measured_mm[rows]
        within = [self._inside[row] for row in rows]

        normals = definition.normals[markers] @ fit.rotation.T
        facing = _facing(normals, measured, definition.maximum_angle_deg)
        used = self._kept(list(range(len(markers))), facing, markers, MarkerState.BEYOND_ANGLE)
        status = _status([within[k] for k in used], definition)
        if sum(within[k] for k in used) >= definition.minimum_markers:
            used = self._kept(used, within, markers, DROPPED_OUT_OF_VOLUME)
        if len(used) < definition.minimum_markers:
            return self._verdict(None, status, ToolInformation.TOO_FEW_MARKERS, chosen.face)

        body = definition.markers_mm[markers]
        if len(used) < len(markers):
            fit = fit_rigid_body(body[used], measured[used])
        near = [False] * len(markers)
        for k, distance in zip(used, fit.distances_mm.tolist(), strict=True):
            near[k] = distance <= definition.maximum_error_mm
        good = self._kept(used, near, markers, MarkerState.BEYOND_ERROR)
        if len(good) < definition.minimum_markers or not _spread_enough(body[good], definition):
            return self._verdict(None, status, ToolInformation.BAD_FIT, chosen.face)
        if len(good) < len(used):
            fit = fit_rigid_body(body[good], measured[good])
        for k in good:
            self._digits[markers[k]] = int(MarkerState.USED) if within[k] else USED_OUT_OF_VOLUME
        return self._verdict(_pose(fit), status, chosen.face << FACE_BITS, chosen.face)

    def _kept(self, numbers: list[int], keep: list[bool], markers: list[int], digit: int) -> list[int]:
        """The markers that pass a rule; the others are assigned the digit of that rule."""
        for k in numbers:
            if not keep[k]:
                self._digits[markers[k]] = int(digit)
        return [k for k in numbers if keep[k]]

    def _verdict(self, pose: ToolPose | None, status: PortStatus, information: int, face: int) -> Tracked:
        points = tuple((x, y, z) for x, y, z in self._measured_mm.tolist())
        seen, inside = tuple(self._seen), tuple(self._inside)
        return Tracked(pose, status, int(information), tuple(self._digits), face, seen, points, inside)


def _facing(normals: Vectors, markers_mm: Vectors, maximum_angle_deg: float) -> list[bool]:
    """Which markers face the sensor (the origin) within the maximum angle."""
    towards = -(normals * markers_mm).sum(axis=1)
    limit = cos(radians(maximum_angle_deg)) * np.sqrt((markers_mm * markers_mm).sum(axis=1))
    facing: list[bool] = (towards >= limit).tolist()
    return facing


def _status(inside: list[bool], definition: ToolDefinition) -> PortStatus:
    """Out of volume: every marker outside. Partially out: too few inside because others are outside."""
    count = sum(inside)
    if count == len(inside) or count >= definition.minimum_markers:
        return PortStatus(0)
    return PortStatus.PARTIALLY_OUT_OF_VOLUME if count else PortStatus.OUT_OF_VOLUME


def _spread_enough(body_mm: Vectors, definition: ToolDefinition) -> bool:
    """Whether the spread of the used markers is large enough along each of their principal axes.

    NDI's measure is not public; here it is the distance between the outermost markers.
    """
    if not any(definition.minimum_spread_mm):
        return True
    centred = body_mm - body_mm.mean(axis=0)
    extents = np.sort(np.ptp(centred @ np.linalg.svd(centred)[2].T, axis=0))[::-1]
    return bool((extents >= np.array(definition.minimum_spread_mm)).all())


def _pose(fit: RigidFit) -> ToolPose:
    w, qx, qy, qz = quaternion_from_rotation(fit.rotation).tolist()
    x, y, z = fit.translation_mm.tolist()
    return ToolPose((w, qx, qy, qz), (x, y, z), float(np.sqrt(np.mean(fit.distances_mm**2))))
