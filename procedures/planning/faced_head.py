"""Head with a face as obstacles: one ellipsoid around the cranium, and one around what is below it.

A single ellipsoid around cranium, nose, chin and neck would reach centimetres into the room over the
forehead, where guides are held.
"""

from __future__ import annotations

import numpy as np

from procedures.planning.head_in_ct import HeadEllipsoid, least_ellipsoid
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.surface import Surface
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, covering_ellipsoid
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.vectors import vector3

CRANIUM_MM = 90.0  # from the vertex down to where a usual cranium is widest
APART_MM = 2.5  # between samples of the skin
FACE = "face"


def fit_cranium_and_face(skin: Surface) -> tuple[HeadEllipsoid, HeadEllipsoid]:
    """Return an ellipsoid around the cranium, and one around what is below it.

    The lower half of the cranium, hidden by the face, counts as the mirror image of the upper.
    """
    axes, points = HeadAxes.of(skin), skin.points_mm
    is_cranium = axes.depth_mm(points) < CRANIUM_MM
    upper, middle_mm = points[is_cranium], axes.vertex_mm - CRANIUM_MM * axes.scale
    mirrored = upper * (1.0, 1.0, -1.0) + (0.0, 0.0, 2.0 * middle_mm)
    return _around(np.vstack([upper, mirrored])), _around(points[~is_cranium])


def face_bodies(face: HeadEllipsoid) -> tuple[Obstacle, ...]:
    """Return the capsules that stand for what is below the cranium, CT frame."""
    capsules: tuple[Capsule, ...] = covering_ellipsoid(face.semi_axes_mm, Pose(face.centre_mm))
    return tuple(Obstacle(FACE, one, True) for one in capsules)


def _around(points_mm: Array) -> HeadEllipsoid:
    centre, semi = least_ellipsoid(points_mm)
    return HeadEllipsoid(centre_mm=vector3(centre), semi_axes_mm=vector3(semi + APART_MM))
