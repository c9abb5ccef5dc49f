"""Regions of a head by name, and its hair."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.smooth_field import smooth_field
from sim.world.rigid import Array, Vectors


class Region(StrEnum):
    """Regions of the skin."""

    NOSE = "nose"
    BROW = "brow"
    EYE = "eye"
    FOREHEAD = "forehead"
    CHEEK = "cheek"
    EAR = "ear"
    JAW = "jaw"
    VAULT = "vault"
    OCCIPUT = "occiput"
    NECK = "neck"


OCCIPUT_BEHIND = 0.45  # share of the semi-axis to the back
OCCIPUT_BELOW = 0.35  # share of the semi-axis to the vertex
EYE_MM = 4.0  # skin around the eyeball that belongs to the eye

# The hair line by the angle from the front: at the forehead above the nose's root, else from the tragion.
TEMPLE_DEG, OVER_EAR_DEG, BEHIND_EAR_DEG, NAPE_DEG = 62.0, 88.0, 118.0, 180.0
OVER_EAR_MM, BEHIND_EAR_MM, NAPE_MM = 38.0, -8.0, -45.0
TEMPLE_SHARE = 0.35  # of the height at the forehead
EDGE_MM = 8.0  # over which the hair grows dense
TUFT_MM, STRAND_MM = 18.0, 1.5  # lengths over which thickness and gaps of the hair vary
TUFT_SHARE = 0.35  # standard deviation of the thickness, relative to its mean
RANK_SLOPE = 1.702  # of the logistic curve nearest to the normal distribution


def regions(head: ParametricHead, points_mm: Vectors) -> NDArray[np.str_]:
    """Return the region's name (n,) of each point (n, 3) on the skin."""
    x, y, z = np.asarray(points_mm, dtype=float).reshape(-1, 3).T
    parts = head.parts(x, y, z)
    own = np.asarray(points_mm, dtype=float).reshape(-1, 3) - head.centre_ct_mm
    bodies = {
        Region.NOSE: parts.nose,
        Region.BROW: parts.brow,
        Region.EYE: parts.eye,
        Region.CHEEK: parts.cheek,
        Region.JAW: parts.jaw,
        Region.EAR: parts.ear,
        Region.NECK: parts.neck,
        Region.VAULT: parts.cranium,
    }
    names = np.array([str(name) for name in bodies], dtype=f"<U{max(map(len, Region))}")
    nearest = np.array([body.value for body in bodies.values()])
    found: NDArray[np.str_] = names[np.argmin(nearest, axis=0)]
    found[(parts.eye.value < EYE_MM) & (found != Region.NOSE)] = Region.EYE
    _, b, c = head.semi_axes_mm
    on_cranium = found == Region.VAULT
    found[on_cranium & (own[:, 1] > OCCIPUT_BEHIND * b) & (own[:, 2] < OCCIPUT_BELOW * c)] = Region.OCCIPUT
    found[on_cranium & (own[:, 1] < 0.0) & (above_hair_line_mm(head, points_mm) < 0.0)] = Region.FOREHEAD
    return found


def above_hair_line_mm(head: ParametricHead, points_mm: Vectors) -> Array:
    """Return the height (n,) of points above the hair line on their side of the head."""
    own = np.asarray(points_mm, dtype=float).reshape(-1, 3) - head.centre_ct_mm
    marks, face = head.landmarks, head.face
    tragion = head.semi_axes_mm[2] - face.tragion_below_vertex_mm
    line = (
        (0.0, marks.sellion_mm + face.hair_line_mm),
        (TEMPLE_DEG, marks.sellion_mm + TEMPLE_SHARE * face.hair_line_mm),
        (OVER_EAR_DEG, tragion + OVER_EAR_MM),
        (BEHIND_EAR_DEG, tragion + BEHIND_EAR_MM),
        (NAPE_DEG, tragion + NAPE_MM),
    )
    angle_deg = np.degrees(np.arctan2(np.abs(own[:, 0]), -own[:, 1]))
    angles, heights = zip(*line, strict=True)
    return np.asarray(own[:, 2] - np.interp(angle_deg, angles, heights))


def hair_mm(head: ParametricHead, points_mm: Vectors) -> Array:
    """Return the thickness (n,) of the hair over points of the skin; 0 where none grows."""
    points = np.asarray(points_mm, dtype=float).reshape(-1, 3)
    face = head.face
    if face.hair_mm == 0.0:
        return np.zeros(len(points))
    dense = np.clip(above_hair_line_mm(head, points) / EDGE_MM, 0.0, 1.0)
    on_ear = head.parts(*points.T).ear.value < 1.0
    tufts = np.maximum(1.0 + TUFT_SHARE * smooth_field(face.hair_seed, "hair tufts", TUFT_MM).at(points), 0.0)
    return np.asarray(np.where(on_ear, 0.0, face.hair_mm * dense * tufts))


def hidden_by_hair(head: ParametricHead, points_mm: Vectors) -> NDArray[np.bool_]:
    """Return whether strands hide each point (n,) of the skin: the stated share, in strands."""
    points = np.asarray(points_mm, dtype=float).reshape(-1, 3)
    face = head.face
    if face.hair_mm == 0.0 or face.hair_share == 0.0:
        return np.zeros(len(points), dtype=bool)
    dense = np.clip(above_hair_line_mm(head, points) / EDGE_MM, 0.0, 1.0)
    strands = smooth_field(face.hair_seed, "hair strands", STRAND_MM, 0.5).at(points)
    # The field is normal: its rank is uniform, to a good approximation by the logistic curve.
    rank = 1.0 / (1.0 + np.exp(-RANK_SLOPE * strands))
    return np.asarray((hair_mm(head, points) > 0.0) & (rank < face.hair_share * dense))
