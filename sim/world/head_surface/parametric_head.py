"""Head of a face's measures: smooth union of ellipsoids and rods on the cranium.

Own coordinates: from the centre of the cranium's ellipsoid, x to the left, y to the back, z to the vertex.
Left and right are alike but for folded ears: |x| serves both.
"""

from __future__ import annotations

from functools import cached_property
from math import asin, radians
from typing import NamedTuple

import numpy as np

from sim.world.head_surface.blending import Field, Values, carve, cone, ellipsoid, turned_ellipsoid, unite
from sim.world.head_surface.distance_grid import DistanceGrid
from sim.world.head_surface.face import Face
from sim.world.head_surface.surface import march
from sim.world.rigid import Array, Point, Vectors, as_point

EAR_PLATE_MM = 3.5  # half the thickness of an ear
EAR_FLAT_RAD = radians(4.0)  # turn of a folded ear
STEEPEST_EAR = 0.9  # sine of the turn of an ear that stands off
EAR_BEHIND_MM = 98.0  # of the tragion before the back of the head
CHIN_BEHIND_MM = 2.0  # of the chin behind the brow
NECK_TO_MM = 330.0  # below the centre: beyond every field of view
PUPIL_BELOW_SELLION_MM = 6.0
BROW_ABOVE_SELLION_MM = 11.0
MOUTH_SHARE = 0.32  # of the way from the nose to the chin
ROOM_MM = 12.0  # of the grid around the head
NECK_SHOWN_MM = 40.0  # below the chin: rays meet nothing further down
NOSE_BALL_MM = 9.5


class Parts(NamedTuple):
    """Bodies of a head by name, as distances."""

    cranium: Field
    nose: Field
    brow: Field
    socket: Field
    eye: Field
    cheek: Field
    jaw: Field
    ear: Field
    concha: Field
    neck: Field

    def whole(self) -> Field:
        """Return the head: the union of all."""
        head = unite(self.cranium, self.cheek, 20.0)
        head = unite(head, self.jaw, 16.0)
        head = unite(head, self.neck, 18.0)
        head = unite(head, self.brow, 9.0)
        head = carve(head, self.socket, 8.0)
        head = unite(head, self.nose, 8.0)
        head = unite(head, self.eye, 5.0)
        ear = carve(self.ear, self.concha, 3.0)
        return unite(head, ear, 4.0)


class ParametricHead:
    """A head on a cranium of these semi-axes, with this face."""

    def __init__(self, centre_ct_mm: Point, semi_axes_mm: Point, face: Face) -> None:
        self.centre_ct_mm, self.semi_axes_mm, self.face = centre_ct_mm, semi_axes_mm, face
        self._marks = Landmarks.of(semi_axes_mm, face)

    @property
    def landmarks(self) -> Landmarks:
        """Heights and places of the face, from the centre of the cranium."""
        return self._marks

    def distance_mm(self, points_mm: Vectors) -> Array:
        """Return the distance (n,) of points (n, 3), positive outside; exact near the surface."""
        return np.asarray(self.field(*_columns(points_mm)).distance())

    def normals(self, points_mm: Vectors) -> Vectors:
        """Return outward unit normals (n, 3) at points near the surface."""
        return self.field(*_columns(points_mm)).normals()

    def cast(self, origins_mm: Vectors, directions: Vectors, furthest_mm: float) -> Array:
        """Return the distance (n,) along unit directions to the first hit; NaN without one."""
        start, end = self.fine_grid.approach(origins_mm, directions, furthest_mm)
        return march(self.distance_mm, origins_mm, directions, end, start)

    @cached_property
    def grid(self) -> DistanceGrid:
        """Coarse distances, with which painters skip empty space."""
        low, high = self.bounds_mm
        return DistanceGrid.sample(self._cautious, low, high)

    @cached_property
    def fine_grid(self) -> DistanceGrid:
        """Finer distances, with which rays come close to the surface."""
        return self.grid.refine(self._cautious)

    def _cautious(self, x: Values, y: Values, z: Values) -> Values:
        return self.field(x, y, z).cautious()

    @property
    def extent_mm(self) -> tuple[Point, Point]:
        """Lowest and highest coordinates, from the chin to the vertex."""
        marks, (cx, cy, cz) = self._marks, self.centre_ct_mm
        a, b, c = self.semi_axes_mm
        wide = a + self.face.ear_protrusion_mm
        nose = marks.nose_tip[1] - NOSE_BALL_MM
        return (cx - wide, cy + nose, cz + marks.menton_mm), (cx + wide, cy + b, cz + c)

    @property
    def bounds_mm(self) -> tuple[Point, Point]:
        """Corners of the grid: the head with a part of its neck, and room around."""
        (x, y, z), high = self.extent_mm
        return (x - ROOM_MM, y - ROOM_MM, z - NECK_SHOWN_MM), as_point(np.add(high, ROOM_MM))

    def field(self, x: Values, y: Values, z: Values) -> Field:
        """Return distance and gradient at points of the CT frame."""
        return self.mirrored(x, self.parts(x, y, z).whole())

    def own(self, x: Values, y: Values, z: Values) -> tuple[Values, Values, Values]:
        """Return points of the CT frame from the centre of the cranium."""
        cx, cy, cz = self.centre_ct_mm
        return x - cx, y - cy, z - cz

    def mirrored(self, x: Values, field: Field) -> Field:
        """Return the field with the gradient along x instead of |x|."""
        return Field(field.value, np.where(x < self.centre_ct_mm[0], -field.x, field.x), field.y, field.z)

    def parts(self, x: Values, y: Values, z: Values) -> Parts:
        """Return the bodies at points of the CT frame, gradients along |x|."""
        face, marks = self.face, self._marks
        a, b, c = self.semi_axes_mm
        side, y, z = self.own(x, y, z)
        left, x = side > 0.0, np.abs(side)
        sellion, menton, nose_base = marks.sellion_mm, marks.menton_mm, marks.nose_base_mm
        eye = marks.eye(face)
        face_half, jaw_half = 0.5 * face.face_width_mm, 0.5 * face.jaw_width_mm
        front = marks.face_front_mm

        middle = ellipsoid(
            x, y, z, (0.0, front + 54.0, sellion - 38.0), (face_half - 7.0, 54.0, 0.42 * face.face_length_mm)
        )
        bone = ellipsoid(x, y, z, (face_half - 22.0, front + 38.0, sellion - 32.0), (22.0, 25.0, 15.0))
        lower = ellipsoid(x, y, z, (0.0, front + 50.0, menton + 40.0), (jaw_half - 2.0, 47.0, 38.0))
        chin = ellipsoid(x, y, z, (0.0, front + 17.0, menton + 16.0), (21.0, 16.0, 16.0))
        lips = ellipsoid(x, y, z, (0.0, front + 11.0, marks.mouth_mm), (25.0, 13.0, 9.0))
        bridge = cone(x, y, z, (0.0, marks.nose_root_mm, sellion), marks.nose_tip, (6.0, NOSE_BALL_MM))
        wing = ellipsoid(
            x,
            y,
            z,
            (0.5 * face.nose_breadth_mm - 6.5, marks.nose_tip[1] + 13.0, nose_base + 7.0),
            (6.5, 9.0, 7.0),
        )
        folds = np.where(left, *face.ear_folds).astype(x.dtype)
        open_rad = asin(min(face.ear_protrusion_mm / face.ear_breadth_mm, STEEPEST_EAR))
        turn = open_rad + (EAR_FLAT_RAD - open_rad) * folds  # of the ear's plate from the sagittal plane
        half = 0.5 * face.ear_breadth_mm
        ear_centre = (marks.ear[0] + half * np.sin(turn), marks.ear[1] + half * np.cos(turn), marks.ear[2])
        plate = turned_ellipsoid(
            x, y, z, ear_centre, (EAR_PLATE_MM, half + 3.0, 0.5 * face.ear_length_mm), -turn
        )
        hollow_centre = (ear_centre[0] + 6.0 * np.cos(turn), ear_centre[1] - 6.0 * np.sin(turn), marks.ear[2])
        hollow = turned_ellipsoid(
            x, y, z, hollow_centre, (5.5, 0.62 * half, 0.27 * face.ear_length_mm), -turn
        )
        return Parts(
            cranium=ellipsoid(x, y, z, (0.0, 0.0, 0.0), (a, b, c)),
            nose=unite(bridge, wing, 5.0),
            brow=cone(x, y, z, *marks.brow(face), (face.brow_mm, face.brow_mm)),
            socket=ellipsoid(x, y, z, (eye[0], eye[1] - 12.0, eye[2]), (16.0, 11.0, 10.0)),
            eye=ellipsoid(x, y, z, eye, (12.5, 12.5, 12.5)),
            cheek=unite(middle, bone, 14.0),
            jaw=unite(unite(lower, chin, 14.0), lips, 9.0),
            ear=plate,
            concha=hollow,
            neck=cone(
                x,
                y,
                z,
                (0.0, 20.0, -70.0),
                (0.0, 55.0, -NECK_TO_MM),
                (face.neck_mm - 4.0, face.neck_mm + 4.0),
            ),
        )


class Landmarks(NamedTuple):
    """Places of the face from the centre of the cranium."""

    sellion_mm: float  # heights
    nose_base_mm: float
    menton_mm: float
    nose_root_mm: float  # y of the axis of the nose at its root
    face_front_mm: float  # y of lips and chin
    brow_front_mm: float
    nose_tip: Point  # centre of its ball
    ear: Point  # front edge of the ear

    def eye(self, face: Face) -> Point:
        """Return the centre of the left eye."""
        return 0.5 * face.eye_distance_mm, self.brow_front_mm + 27.0, self.sellion_mm - PUPIL_BELOW_SELLION_MM

    def brow(self, face: Face) -> tuple[Point, Point]:
        """Return the ends of the axis of the left brow."""
        y, z = self.brow_front_mm + face.brow_mm, self.sellion_mm + BROW_ABOVE_SELLION_MM
        return (6.0, y, z), (0.62 * face.eye_distance_mm, y + 12.0, z + 2.0)

    @property
    def mouth_mm(self) -> float:
        """Height of the mouth."""
        return self.nose_base_mm + MOUTH_SHARE * (self.menton_mm - self.nose_base_mm)

    @classmethod
    def of(cls, semi_axes_mm: Point, face: Face) -> Landmarks:
        """Place the face on a cranium."""
        a, b, c = semi_axes_mm
        sellion = c - face.sellion_below_vertex_mm
        nose_base = sellion - face.nose_length_mm
        front = -b + CHIN_BEHIND_MM
        tragion = c - face.tragion_below_vertex_mm
        ear_y = b - EAR_BEHIND_MM
        beside = max(1.0 - (tragion / c) ** 2 - (ear_y / b) ** 2, 0.1)
        return cls(
            sellion_mm=sellion,
            nose_base_mm=nose_base,
            menton_mm=sellion - face.face_length_mm,
            nose_root_mm=-b + 7.0,
            face_front_mm=front,
            brow_front_mm=-b - 1.0,
            nose_tip=(0.0, front - face.nose_protrusion_mm + 9.0, nose_base + 9.0),
            ear=(a * beside**0.5 - 1.0, ear_y, tragion + 4.0),
        )


def _columns(points_mm: Vectors) -> tuple[Array, Array, Array]:
    x, y, z = np.ascontiguousarray(np.asarray(points_mm, dtype=float).reshape(-1, 3).T)
    return x, y, z
