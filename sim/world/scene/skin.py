"""Skin of a scene's head: in the CT, and as it is in the theatre."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from sim.world.head_surface.bare_bone import HeadWithBareBone
from sim.world.head_surface.ellipsoidal_head import EllipsoidalHead
from sim.world.head_surface.face import Face
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.skin_shift import ShiftedHead, SkinShift
from sim.world.head_surface.skull_surface import SkullSurface
from sim.world.head_surface.surface import HeadSurface
from sim.world.head_surface.volume_head import VolumeHead, read_head
from sim.world.rigid import Point, Vector
from sim.world.scene.model import Head

FAR_MM = 400.0  # from the centre: outside every head
GRID_LINES, FINER_GRIDS = 21, 4  # of parallel rays that look for the furthest place


def head_with_face(head: Head) -> ParametricHead | None:
    """Return the parametric head of a scene's head in the CT, or None if it has no face."""
    if head.face is None:
        return None
    return _build(head.centre_ct_mm, head.semi_axes_mm, head.face)


def head_in_theatre(head: Head) -> ParametricHead | None:
    """Return the parametric head on the table, or None if it has no face."""
    if head.exchanged is None:
        return head_with_face(head)
    return _build(head.centre_ct_mm, head.exchanged.semi_axes_mm, head.exchanged.face)


def skin_in_ct(head: Head) -> HeadSurface:
    """Return the skin as the CT shows it."""
    if head.own_ct is not None:
        return _read(head.own_ct)
    return head_with_face(head) or EllipsoidalHead(head.centre_ct_mm, head.semi_axes_mm)


def skin_in_theatre(head: Head) -> HeadSurface:
    """Return the skin as it is in the theatre, in the CT frame: where `robot_from_ct` puts it."""
    faced = head_in_theatre(head)
    if faced is None:
        return skin_in_ct(head)
    skin = faced if head.skin_shift.is_none else _shift(faced, head.skin_shift)
    return skin if head.bare_bone is None else HeadWithBareBone(skin, SkullSurface(faced), head.bare_bone)


def prepare_skin(head: Head) -> None:
    """Sample the skin in the theatre now, so that neither a picture nor a touching hand waits for it."""
    middle = np.array([head.centre_ct_mm])
    skin_in_theatre(head).cast(middle + np.array([0.0, 0.0, FAR_MM]), np.array([[0.0, 0.0, -1.0]]), FAR_MM)


def skin_point(head: Head, direction: Vector) -> tuple[Vector, Vector]:
    """Return the skin's outermost point in a direction from the centre, CT frame, and its outward normal."""
    skin, centre = skin_in_ct(head), np.array(head.centre_ct_mm)
    inwards = -np.asarray(direction) / np.linalg.norm(direction)
    start = centre - FAR_MM * inwards
    along = skin.cast(start[None], inwards[None], FAR_MM)
    point = start + along[0] * inwards
    return point, skin.normals(point[None])[0]


def find_furthest(head: Head, direction: Vector) -> Vector:
    """Return where the skin in the theatre reaches furthest in a direction, CT frame: such as an ear.

    `direction` is in shares of the head's size. Of a head without a face, that is a point of its ellipsoid.
    """
    centre, axes = np.array(head.centre_ct_mm), np.array(head.semi_axes_mm)
    if head.face is None:
        return np.asarray(centre + axes * direction)
    outwards = direction / np.linalg.norm(direction)
    across = np.linalg.svd(outwards[None])[2][1:]
    skin, middle, half_mm = skin_in_theatre(head), centre, float(axes.max())
    for _ in range(FINER_GRIDS):
        steps = np.linspace(-half_mm, half_mm, GRID_LINES)
        grid = (steps[:, None, None] * across[0] + steps[:, None] * across[1]).reshape(-1, 3)
        starts = middle + FAR_MM * outwards + grid
        away = skin.cast(starts, np.broadcast_to(-outwards, starts.shape), 2.0 * FAR_MM)
        nearest = int(np.nanargmin(away))
        found = starts[nearest] - away[nearest] * outwards
        middle = found - outwards * ((found - centre) @ outwards)
        half_mm *= 3.0 / GRID_LINES
    return np.asarray(found)


def head_extent(head: Head) -> tuple[Vector, Vector]:
    """Return the lowest and highest coordinates of the head, CT frame, without the neck."""
    faced = head_with_face(head)
    if faced is not None:
        return np.array(faced.extent_mm[0]), np.array(faced.extent_mm[1])
    centre, axes = np.array(head.centre_ct_mm), np.array(head.semi_axes_mm)
    return centre - axes, centre + axes


@lru_cache(maxsize=8)  # with the distances that casting rays prepares
def _shift(head: ParametricHead, shift: SkinShift) -> ShiftedHead:
    return ShiftedHead(head, shift)


@lru_cache(maxsize=2)
def _read(series: str) -> VolumeHead:
    return read_head(Path(series))


@lru_cache(maxsize=8)
def _build(centre_ct_mm: Point, semi_axes_mm: Point, face: Face) -> ParametricHead:
    return ParametricHead(centre_ct_mm, semi_axes_mm, face)
