"""Which face of a tool is tracked: the one facing the sensor most directly, with hysteresis."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, degrees

import numpy as np
from numpy.typing import NDArray

from sim.polaris.measurement.rigid_fit import RigidFit, fit_rigid_body
from sim.polaris.tools.definition import ToolDefinition

Vectors = NDArray[np.float64]

LEAST_TO_FIT = 3
HYSTERESIS_DEG = 2.0  # by which another face must face the sensor more directly than the tracked one
ONLY_FACE = 1
ALL_FACES = 0xFF


@dataclass(frozen=True)
class FittedFace:
    """The visible markers of one face: their numbers, their rows in the measurement, and the fit."""

    face: int
    markers: list[int]
    rows: list[int]
    fit: RigidFit


def best_face(
    definition: ToolDefinition,
    seen: list[int],
    measured_mm: Vectors,
    previous: int = 0,
    allowed: int = ALL_FACES,
) -> FittedFace | None:
    """The face to track; None if no face has enough visible markers for a fit.

    `seen` are the numbers of the markers in `measured_mm` (n, 3), in the same order, `previous` is the face
    of the last frame, `allowed` has one bit per face that may be tracked, lowest bit for face 1.
    """
    faces = [face for face in sorted(set(definition.faces)) or [ONLY_FACE] if allowed >> (face - 1) & 1]
    if len(faces) == 1:
        return _fit(definition, faces[0], seen, measured_mm)
    candidates: dict[int, tuple[float, FittedFace]] = {}
    for face in faces:
        fitted = _fit(definition, face, seen, measured_mm)
        if fitted is not None:
            candidates[face] = (_turned_away_deg(definition, fitted), fitted)
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


def _turned_away_deg(definition: ToolDefinition, fitted: FittedFace) -> float:
    """Angle between the normal of a face and the direction to the sensor (the origin).

    0 for normals that cancel out, as of markers back to back: such a face is seen from all around.
    """
    members = [marker for marker, face in enumerate(definition.faces) if face == fitted.face]
    normal = fitted.fit.rotation @ definition.normals[members].mean(axis=0)
    towards = -(fitted.fit.rotation @ definition.markers_mm[members].mean(axis=0) + fitted.fit.translation_mm)
    return degrees(atan2(float(np.linalg.norm(np.cross(normal, towards))), float(normal @ towards)))
