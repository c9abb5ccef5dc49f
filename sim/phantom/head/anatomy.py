"""Anatomy of the painted head: layers by depth below the skin, headrest, cable and markers."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from sim.errors import BAD_SCENE
from sim.phantom.head.painting import Band, Streak
from sim.phantom.head.shapes import Ball, Cable, Ellipsoid, Rod, Shape, Trough, Values, ellipsoid_depth
from sim.world.head_surface.parametric_head import Landmarks
from sim.world.noise import noise
from sim.world.rigid import Point, as_point
from sim.world.scene.model import Fiducial, Head, Scene
from sim.world.scene.skin import head_extent, head_with_face, skin_in_ct
from sim.world.skull import DIPLOE_MM, INNER_TABLE_MM, OUTER_TABLE_MM, SCALP_LAYERS_MM, SCALP_MM

AIR_HU = -1000.0
# thickness in mm and HU, from the skin inwards; the last one fills the rest
LAYERS = (
    *zip(SCALP_LAYERS_MM, (35.0, -80.0, 50.0), strict=True),  # skin, fat, galea and muscle
    (OUTER_TABLE_MM, 1450.0),  # of the skull
    (DIPLOE_MM, 650.0),
    (INNER_TABLE_MM, 1450.0),
    (2.0, 10.0),  # cerebrospinal fluid
    (4.5, 38.0),  # grey matter
    (0.0, 29.0),  # white matter
)
STEP_MM = 0.05
OUTSIDE_MM = 4.0
BLUR_MARGIN = 4.0  # of the blur's sigma

CSF_HU = 8.0
ENAMEL_HU = 2100.0
JAW_HU = 900.0
METAL_HU = 8000.0  # saturates whatever the scanner can store
FOAM_HU = -930.0
SHELL_HU = 120.0
SHEATH_HU = 280.0

TEETH = 14
FILLINGS = 5
TEETH_ARC_RAD = radians(75.0)
TEETH_BELOW_CENTRE = 0.66  # of the head's semi-axis towards the feet
TEETH_ARC_MM = (23.0, 27.0)  # half width and depth of the dental arch
TEETH_FRONT = 0.27  # of the semi-axis to the front: middle of the arch
TOOTH_MM = (2.9, 2.9, 5.5)
FILLING_RADIUS_MM = 1.7
LIPS_MM = 14.0  # before the teeth
LONGEST_POST_MM = 100.0

JAW_RADIUS_MM = 4.0
FRONTAL_MM, CHEEKS_MM, NASAL_MM = (7.0, 4.0, 8.0), (11.0, 13.0, 12.0), (8.0, 10.0, 7.0)  # air cavities

FOAM_GAP_MM = 3.0
FOAM_MM = 10.0
SHELL_MM = 3.0
HEADREST_HALF_ARC_RAD = radians(55.0)
CABLE_GAP_MM = 20.0
CABLE_BEHIND_MM = 35.0
CABLE_SWING_MM = (6.0, 4.0)
CABLE_WAVE_MM = 130.0
SHEATH_RADIUS_MM = 3.0
WIRE_RADIUS_MM = 0.9

SPHERE_HU = (100.0, 150.0)
FILM_MM = 0.1
FILM_HU = 600.0
POST_DEPTH_MM = 1.5  # the post enters the sphere by this much
POST_RADIUS_MM = 2.0
METAL_POSTS = 0.75  # share of metal posts; the others are polymer
POST_METAL_HU = 3500.0
POST_POLYMER_HU = 180.0
FLANGE_RADIUS_MM = 4.0
FLANGE_MM = 1.5
SCREW_IN_BONE_MM = 5.0


class HeadLayers:
    """Intensity of the head's layers by depth, with edges blurred by a Gaussian of `blur_mm`.

    The layers are those of a CT unless others are given, with the intensity of `air` around the head.
    """

    def __init__(
        self,
        centre: Point,
        semi_axes: Point,
        blur_mm: float,
        layers: tuple[tuple[float, float], ...] = LAYERS,
        air: float = AIR_HU,
    ) -> None:
        self.centre = centre
        self.semi_axes = semi_axes
        inside_mm = sum(thickness for thickness, _ in layers) + OUTSIDE_MM
        depths = np.arange(-OUTSIDE_MM, inside_mm, STEP_MM)
        table = np.full(len(depths), air)
        top = 0.0
        for thickness, hu in layers:
            table[depths >= top] = hu
            top += thickness
        self._table = blur_table(table, blur_mm / STEP_MM).astype(np.float32)

    def hu_at(self, x: Values, y: Values, z: Values) -> Values:
        """Return the HU at the given points, using air outside the head."""
        depth = ellipsoid_depth(x, y, z, self.centre, self.semi_axes)
        place = (depth + np.float32(OUTSIDE_MM)) * np.float32(1.0 / STEP_MM) + np.float32(0.5)
        last = np.float32(len(self._table) - 1)
        hu: Values = self._table[np.clip(place, np.float32(0.0), last).astype(np.int32)]
        return hu

    def half_widths(self, z_mm: float, margin_mm: float) -> tuple[float, float] | None:
        """Return the head's half extents in x and y at `z_mm` plus a margin, or None outside."""
        a, b, c = (axis + margin_mm for axis in self.semi_axes)
        squared = 1.0 - ((z_mm - self.centre[2]) / c) ** 2
        return None if squared <= 0.0 else (a * sqrt(squared), b * sqrt(squared))


def blur_table(table: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Blur a row of values by a Gaussian of `sigma` steps."""
    if sigma <= 0.0:
        return table
    margin = int(np.ceil(BLUR_MARGIN * sigma))
    kernel = np.exp(-0.5 * (np.arange(-margin, margin + 1) / sigma) ** 2)
    padded = np.pad(table, margin, mode="edge")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")


@dataclass(frozen=True)
class SkinMarker:
    """A painted sphere with its post, whose material is `post`."""

    fiducial: Fiducial
    hu: float
    post: str
    shapes: tuple[Shape, ...]


@dataclass(frozen=True)
class Anatomy:
    """Bodies painted over the head's layers, in painting order, and the sources of metal streaks."""

    headrest: tuple[Shape, ...]  # the same in all slices
    surroundings: tuple[Shape, ...]
    markers: tuple[SkinMarker, ...]
    fillings: tuple[Ball, ...]
    streaks: tuple[Streak, ...] = ()  # from metal other than fillings
    bands: tuple[Band, ...] = ()
    deceiving: tuple[Point, ...] = ()  # places of look-alikes, painted as precisely as markers

    @property
    def places(self) -> tuple[Point, ...]:
        """Centres of the finely painted regions: first the markers, then the look-alikes."""
        return (*(marker.fiducial.centre_ct_mm for marker in self.markers), *self.deceiving)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """All bodies, in painting order."""
        return (
            *self.headrest,
            *self.surroundings,
            *(shape for marker in self.markers for shape in marker.shapes),
        )


def draw_anatomy(scene: Scene) -> Anatomy:
    """Draw the anatomy of a scene from its seed; raises SIM-001 if a post misses the head."""
    generator = noise(scene.seed, "ct anatomy", 0)
    head = scene.head
    teeth, fillings = jaw_teeth(head, generator)
    surroundings = (*side_cable(head), *ventricles(head), *sinuses(head), *teeth, *fillings)
    markers = tuple(marker_on_post(fiducial, head, generator) for fiducial in head.fiducials)
    return Anatomy(trough(head), surroundings, markers, fillings)


def marker_on_post(fiducial: Fiducial, head: Head, generator: np.random.Generator) -> SkinMarker:
    """Return a sphere on a screw in the skull, with a flange on the skin."""
    to_skin = distance_to_skin(fiducial, head)
    to_tip = to_skin + SCALP_MM + SCREW_IN_BONE_MM
    return marker_on_foot(fiducial, to_skin - FLANGE_MM, to_tip, generator)


def bare_marker(fiducial: Fiducial, generator: np.random.Generator) -> SkinMarker:
    """Return a free-floating sphere without film."""
    sphere_hu = float(generator.uniform(*SPHERE_HU))
    return SkinMarker(
        fiducial, sphere_hu, "none", (Ball(sphere_hu, fiducial.centre_ct_mm, fiducial.radius_mm),)
    )


def marker_on_foot(
    fiducial: Fiducial, flange_mm: float, tip_mm: float, generator: np.random.Generator
) -> SkinMarker:
    """Return a sphere whose post ends `tip_mm` below its centre, with a flange from `flange_mm` down."""
    sphere_hu = float(generator.uniform(*SPHERE_HU))
    metal = bool(generator.uniform() < METAL_POSTS)
    post_hu = POST_METAL_HU if metal else POST_POLYMER_HU
    centre, radius = fiducial.centre_ct_mm, fiducial.radius_mm
    inward = scale_vector(fiducial.post_ct, -1.0)
    top = radius - POST_DEPTH_MM
    shapes = (
        Ball(FILM_HU, centre, radius + FILM_MM),
        Ball(sphere_hu, centre, radius),
        Rod(post_hu, shift_point(centre, inward, top), inward, tip_mm - top, POST_RADIUS_MM),
        Rod(post_hu, shift_point(centre, inward, flange_mm), inward, FLANGE_MM, FLANGE_RADIUS_MM),
    )
    return SkinMarker(fiducial, sphere_hu, "metal" if metal else "polymer", shapes)


def marker_on_metal(
    fiducial: Fiducial, head: Head, post_hu: float, post_radius_mm: float, flange_mm: float, sphere_hu: float
) -> SkinMarker:
    """Return a sphere on a metal screw of this radius, with a metal flange of this thickness on the skin."""
    to_skin = distance_to_skin(fiducial, head)
    centre, radius = fiducial.centre_ct_mm, fiducial.radius_mm
    inward = scale_vector(fiducial.post_ct, -1.0)
    top = radius - POST_DEPTH_MM
    tip = to_skin + SCALP_MM + SCREW_IN_BONE_MM
    flange = shift_point(centre, inward, to_skin - flange_mm)
    shapes = (
        Ball(FILM_HU, centre, radius + FILM_MM),
        Ball(sphere_hu, centre, radius),
        Rod(post_hu, shift_point(centre, inward, top), inward, tip - top, post_radius_mm),
        Rod(post_hu, flange, inward, flange_mm, FLANGE_RADIUS_MM),
    )
    return SkinMarker(fiducial, sphere_hu, "metal", shapes)


def distance_to_skin(fiducial: Fiducial, head: Head) -> float:
    """Return the distance in mm from the sphere's centre along its post to the skin."""
    if head.face is not None:
        down = -np.array([fiducial.post_ct])
        found = skin_in_ct(head).cast(np.array([fiducial.centre_ct_mm]), down, LONGEST_POST_MM)[0]
        if np.isnan(found):
            raise BAD_SCENE(f"the post of fiducial {fiducial.number} is not on the head")
        return float(found)
    axes = np.array(head.semi_axes_mm)
    start = (np.array(fiducial.centre_ct_mm) - head.centre_ct_mm) / axes
    along = -np.array(fiducial.post_ct) / axes
    a, b, c = along @ along, start @ along, start @ start - 1.0
    root = b * b - a * c
    if c <= 0.0 or b >= 0.0 or root < 0.0:
        raise BAD_SCENE(f"the post of fiducial {fiducial.number} is not on the head")
    return float((-b - np.sqrt(root)) / a)


def trough(head: Head) -> tuple[Shape, ...]:
    """Return a foam trough with a thin shell, under the back of the head."""
    inner = max(head.semi_axes_mm[:2]) + FOAM_GAP_MM
    outer = inner + FOAM_MM
    centre, cosine = head.centre_ct_mm, cos(HEADREST_HALF_ARC_RAD)
    return (
        Trough(FOAM_HU, centre, inner, outer, cosine),
        Trough(SHELL_HU, centre, outer, outer + SHELL_MM, cosine),
    )


def side_cable(head: Head) -> tuple[Shape, ...]:
    """Return a sheathed wire next to the head."""
    to_cable = head_extent(head)[1][0] - head.centre_ct_mm[0] + CABLE_GAP_MM
    centre = shift_point(head.centre_ct_mm, (1.0, 0.0, 0.0), to_cable)
    centre = shift_point(centre, (0.0, 1.0, 0.0), CABLE_BEHIND_MM)
    return tuple(
        Cable(hu, centre, radius, CABLE_SWING_MM, CABLE_WAVE_MM)
        for hu, radius in ((SHEATH_HU, SHEATH_RADIUS_MM), (METAL_HU, WIRE_RADIUS_MM))
    )


def ventricles(head: Head) -> tuple[Shape, ...]:
    return tuple(
        Ellipsoid(CSF_HU, point_at_share(head, (side * 0.14, 0.0, 0.08)), (5.0, 26.0, 9.0))
        for side in (-1, 1)
    )


def sinuses(head: Head) -> tuple[Shape, ...]:
    """Return the air cavities of forehead, cheeks and nose."""
    if (faced := head_with_face(head)) is not None:
        return _sinuses_of_face(head.centre_ct_mm, faced.landmarks)
    frontal = [((side * 0.14, -0.80, -0.12), FRONTAL_MM) for side in (-1, 1)]
    cheeks = [((side * 0.30, -0.52, -0.45), CHEEKS_MM) for side in (-1, 1)]
    places = [*frontal, *cheeks, ((0.0, -0.30, -0.38), NASAL_MM)]
    return tuple(Ellipsoid(AIR_HU, point_at_share(head, place), size) for place, size in places)


def _sinuses_of_face(centre: Point, marks: Landmarks) -> tuple[Shape, ...]:
    frontal = [
        ((side * 9.0, marks.brow_front_mm + 17.0, marks.sellion_mm + 17.0), FRONTAL_MM) for side in (-1, 1)
    ]
    behind, height = marks.face_front_mm + 42.0, marks.sellion_mm - 37.0
    cheeks = [((side * 25.0, behind, height), CHEEKS_MM) for side in (-1, 1)]
    places = [*frontal, *cheeks, ((0.0, behind, height), NASAL_MM)]
    return tuple(Ellipsoid(AIR_HU, as_point(np.add(centre, place)), size) for place, size in places)


def jaw_teeth(
    head: Head, generator: np.random.Generator, count: int = FILLINGS
) -> tuple[tuple[Shape, ...], tuple[Ball, ...]]:
    """Return an arch of teeth in a jaw, and the metal fillings in some of them."""
    middle = point_at_share(head, (0.0, -TEETH_FRONT, -TEETH_BELOW_CENTRE))
    if (faced := head_with_face(head)) is not None:
        marks = faced.landmarks
        front = (0.0, marks.face_front_mm + LIPS_MM + TEETH_ARC_MM[1], marks.mouth_mm)
        middle = as_point(np.add(head.centre_ct_mm, front))
    width, depth = TEETH_ARC_MM
    angles = np.linspace(-TEETH_ARC_RAD, TEETH_ARC_RAD, TEETH)
    crowns = [
        shift_point(
            shift_point(middle, (1.0, 0.0, 0.0), width * sin(angle)), (0.0, -1.0, 0.0), depth * cos(angle)
        )
        for angle in angles
    ]
    jaw = tuple(
        Ball(JAW_HU, shift_point(crown, (0.0, 0.0, -1.0), TOOTH_MM[2]), JAW_RADIUS_MM) for crown in crowns
    )
    teeth = tuple(Ellipsoid(ENAMEL_HU, crown, TOOTH_MM) for crown in crowns)
    filled = sorted(generator.choice(TEETH, size=count, replace=False).tolist())
    fillings = tuple(
        Ball(METAL_HU, shift_point(crowns[k], (0.0, 0.0, 1.0), TOOTH_MM[2] / 2), FILLING_RADIUS_MM)
        for k in filled
    )
    return (*jaw, *teeth), fillings


def point_at_share(head: Head, relative: Point) -> Point:
    """Return the CT point at the given fractions of the head's semi-axes from its centre."""
    return as_point(
        centre + axis * part
        for centre, axis, part in zip(head.centre_ct_mm, head.semi_axes_mm, relative, strict=True)
    )


def shift_point(point: Point, along: Point, distance: float) -> Point:
    return as_point(value + distance * part for value, part in zip(point, along, strict=True))


def scale_vector(vector: Point, factor: float) -> Point:
    return as_point(factor * value for value in vector)
