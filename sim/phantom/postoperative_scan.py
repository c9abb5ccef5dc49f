"""Postoperative scan: the head in a new pose, without markers but with a run's instruments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import radians
from pathlib import Path

import numpy as np

from sim.errors import NOTHING_TO_VERIFY
from sim.phantom.head.anatomy import (
    AIR_HU,
    LAYERS,
    METAL_HU,
    SCREW_IN_BONE_MM,
    draw_anatomy,
    shift_point,
    side_cable,
)
from sim.phantom.head.faced_layers import Layers, layers_of
from sim.phantom.head.painting import Streak, add_filling_streaks, add_streak, edge_sigma_mm, paint
from sim.phantom.head.shapes import Ball, Bounds, Rod, Shape, Values
from sim.phantom.scan import RAMP_WIDTH, SKIN_MARGIN_MM, slice_noise
from sim.phantom.scanner.fine_painting import middle_at, paint_rod
from sim.phantom.scanner.grid import CtGrid, centre_grid
from sim.world.noise import noise
from sim.world.options import InstrumentKind
from sim.world.rigid import (
    Matrix,
    Point,
    apply,
    as_point,
    inverse,
    matrix_from,
    matrix_of,
    rotation_from_vector,
)
from sim.world.scene.model import CtProtocol, Head, Scene, read_scene
from sim.world.skull import SCALP_MM
from sim.world.truth import SCENE_FILE, THEATRE_FOLDER, read_samples

ABOVE_SKIN_MM = 25.0  # length of an instrument outside the head
FLUID_HU = 15.0  # in a drilled hole: blood and cerebrospinal fluid
BELOW_SKULL_MM = 1.5  # overshoot of a drill beyond the inner table
TO_BRAIN_MM = sum(thickness for thickness, _ in LAYERS[:6])  # skin to the inside of the skull

TURN_RAD = radians(10.0)  # largest rotation of the head between the scans, per axis
SHIFT_MM = 30.0
STREAK_HU = (200.0, 400.0)  # next to the metal
STREAK_LOBES = (4, 5, 6, 7)
STREAK_FALL_MM = 2.5
POST_PLACE = 2  # index of the post among a marker's bodies, see `marker_on_foot`


# Typical sizes: a lead of 1.27 mm, a biopsy needle of 1.8 mm, a twist drill of 3.2 mm.
RADII_MM = {InstrumentKind.ELECTRODE: 0.635, InstrumentKind.NEEDLE: 0.9, InstrumentKind.DRILL_HOLE: 1.6}


@dataclass(frozen=True)
class ImagedInstrument:
    """An instrument left by a run: its tip and outward unit vector in the plan's CT frame."""

    identifier: str
    kind: InstrumentKind
    tip_mm: Point
    outwards: Point

    def rod(self, head: Head) -> Rod:
        """Return the body to paint: a metal rod, or a fluid-filled rod through the skull for a drill hole."""
        skin_mm = _to_skin_mm(self, head)
        if self.kind is not InstrumentKind.DRILL_HOLE:
            return Rod(METAL_HU, self.tip_mm, self.outwards, skin_mm + ABOVE_SKIN_MM, RADII_MM[self.kind])
        deep_mm = TO_BRAIN_MM + BELOW_SKULL_MM
        start = as_point(np.add(self.tip_mm, (skin_mm - deep_mm) * np.array(self.outwards)))
        return Rod(FLUID_HU, start, self.outwards, deep_mm, RADII_MM[self.kind])


def instruments_of(run: Path, kind: InstrumentKind) -> tuple[Scene, tuple[ImagedInstrument, ...]]:
    """Read a run's scene and its instruments at the reached targets; raises SIM-006, SIM-007."""
    theatre = run / THEATRE_FOLDER
    if not (theatre / SCENE_FILE).is_file():
        raise NOTHING_TO_VERIFY(f"{run} has no simulated theatre")
    scene = read_scene(theatre / SCENE_FILE)
    samples = {sample.target: sample for sample in read_samples(theatre)}  # the last one of each target
    if not samples:
        raise NOTHING_TO_VERIFY(f"{run} reached no target")
    robot_from_ct = matrix_of(scene.head.robot_from_ct)
    found = []
    for identifier, sample in samples.items():
        ct_from_robot = inverse(sample.head_moved @ robot_from_ct)
        tip = apply(ct_from_robot, sample.tip_mm)
        inwards = ct_from_robot[:3, :3] @ np.array(sample.axis)
        found.append(
            ImagedInstrument(identifier, kind, as_point(tip), as_point(-inwards / np.linalg.norm(inwards)))
        )
    return scene, tuple(found)


@dataclass(frozen=True, eq=False)
class PostoperativeScan:
    """Contents of a postoperative scan, in its own coordinates."""

    scene: Scene
    seed: int
    protocol: CtProtocol
    grid: CtGrid
    pose: HeadPose
    head: PosedLayers
    bodies: tuple[Shape, ...]
    fillings: tuple[Ball, ...]
    rods: tuple[Rod, ...]
    streaks: tuple[Streak | None, ...]  # one per rod, at the origin; none for a drilled hole

    def paint(self, number: int) -> Values:
        """Paint one slice in HU (rows, columns), including noise."""
        grid = self.grid
        z_mm = float(grid.z_mm[number])
        x, y = grid.x_mm.astype(np.float32), grid.y_mm.astype(np.float32)
        image = np.full((grid.rows, grid.columns), AIR_HU, dtype=np.float32)
        self._paint_head(image, x, y, z_mm)
        axes = (x, y, np.array([z_mm], dtype=np.float32))
        edge_mm = RAMP_WIDTH * edge_sigma_mm(grid.pixel_mm, grid.slice_mm)
        for shape in self.bodies:
            paint(image[None], axes, shape, edge_mm)
        for rod in self.rods:
            paint_rod(image, rod, grid, number)
        for filling in self.fillings:
            add_filling_streaks(image, x, y, z_mm, filling)
        for rod, streak in zip(self.rods, self.streaks, strict=True):
            middle = middle_at(rod, z_mm, grid.slice_mm / 2.0)
            if streak is not None and middle is not None:
                here = Streak((*middle, z_mm), streak.hu, streak.fall_mm, streak.lobes, streak.phase_rad, 1.0)
                add_streak(image, x, y, z_mm, here)
        generator = noise(self.seed, "postoperative ct", number)
        image += slice_noise(generator, image.shape, grid.pixel_mm, self.protocol.noise_HU)
        return image

    def _paint_head(self, image: Values, x: Values, y: Values, z_mm: float) -> None:
        low, high = self.head.bounds(SKIN_MARGIN_MM)
        columns, rows = (self.grid.indices(axis, low[axis], high[axis]) for axis in (0, 1))
        z = np.full((1, 1), z_mm, dtype=np.float32)
        image[rows, columns] = self.head.hu_at(x[None, columns], y[rows, None], z)


def draw_scan(
    scene: Scene, instruments: tuple[ImagedInstrument, ...], seed: int, protocol: CtProtocol | None = None
) -> PostoperativeScan:
    """Draw a head pose from `seed`, removing spheres and bases but leaving screws in the bone."""
    generator = noise(seed, "postoperative pose", 0)
    protocol = protocol or scene.ct
    pose = _draw_pose(scene, generator)
    grid = centre_grid(apply(pose.scan_from_head, scene.head.centre_ct_mm), protocol)
    head = scene.head
    anatomy = draw_anatomy(scene)
    beside = set(side_cable(head))  # belongs to the scanner's room
    screws = (_remaining_screw(marker.shapes[POST_PLACE]) for marker in anatomy.markers)
    edge_mm = edge_sigma_mm(grid.pixel_mm, grid.slice_mm)
    return PostoperativeScan(
        scene=scene,
        seed=seed,
        protocol=protocol,
        grid=grid,
        pose=pose,
        head=PosedLayers(layers_of(head, edge_mm), pose),
        bodies=tuple(
            PosedShape(shape.hu, shape, pose)
            for shape in (*anatomy.surroundings, *screws)
            if shape not in beside
        ),
        fillings=tuple(
            Ball(one.hu, as_point(apply(pose.scan_from_head, one.centre)), one.radius)
            for one in anatomy.fillings
        ),
        rods=tuple(pose.rod(one.rod(head)) for one in instruments),
        streaks=tuple(
            _draw_streak(generator) if one.kind is not InstrumentKind.DRILL_HOLE else None
            for one in instruments
        ),
    )


@dataclass(frozen=True, eq=False)
class HeadPose:
    """Head pose, with `scan_from_head` (4, 4) mapping the plan's CT frame to the new scan's."""

    scan_from_head: Matrix

    def to_head(self, x: Values, y: Values, z: Values) -> tuple[Values, Values, Values]:
        """Map scan coordinates to head coordinates, for broadcastable arrays x, y and z."""
        head_from_scan = inverse(self.scan_from_head).astype(np.float32)
        u, v, w = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in head_from_scan[:3])
        return u, v, w

    def rod(self, rod: Rod) -> Rod:
        """Map a rod to scan coordinates."""
        along = self.scan_from_head[:3, :3] @ np.array(rod.along)
        return Rod(
            rod.hu, as_point(apply(self.scan_from_head, rod.start)), as_point(along), rod.length, rod.radius
        )


@dataclass(frozen=True, eq=False)
class PosedShape(Shape):
    """A body of the head in the new scan."""

    shape: Shape
    pose: HeadPose

    def bounds(self) -> Bounds:
        """Return a box around the rotated bounding box, cached for all slices."""
        return self._box

    @cached_property
    def _box(self) -> Bounds:
        corners = apply(self.pose.scan_from_head, list(product(*zip(*self.shape.bounds(), strict=True))))
        return as_point(corners.min(axis=0)), as_point(corners.max(axis=0))

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        """Return the signed depth in mm."""
        return self.shape.depth(*self.pose.to_head(x, y, z))


@dataclass(frozen=True, eq=False)
class PosedLayers:
    """The head's layers in the new scan."""

    layers: Layers
    pose: HeadPose

    def hu_at(self, x: Values, y: Values, z: Values) -> Values:
        """Return the HU at the given points, using air outside the head."""
        return self.layers.hu_at(*self.pose.to_head(x, y, z))

    def bounds(self, margin_mm: float) -> Bounds:
        """Return a bounding box of the head plus a margin."""
        centre = apply(self.pose.scan_from_head, self.layers.centre)
        turned = self.pose.scan_from_head[:3, :3] * np.array(self.layers.semi_axes)
        half_sides = np.linalg.norm(turned, axis=1) + margin_mm
        return as_point(centre - half_sides), as_point(centre + half_sides)


def _to_skin_mm(instrument: ImagedInstrument, head: Head) -> float:
    """Return the outward distance in mm from the tip to the skin."""
    axes = np.array(head.semi_axes_mm)
    start = np.subtract(instrument.tip_mm, head.centre_ct_mm) / axes
    along = np.array(instrument.outwards) / axes
    a, b, c = along @ along, start @ along, start @ start - 1.0
    if c >= 0.0:
        return 0.0  # the tip is outside the head: the run missed it by far
    return float((np.sqrt(b * b - a * c) - b) / a)


def _draw_pose(scene: Scene, generator: np.random.Generator) -> HeadPose:
    turn = rotation_from_vector(generator.uniform(-TURN_RAD, TURN_RAD, 3))
    centre = np.array(scene.head.centre_ct_mm)
    moved = centre + generator.uniform(-SHIFT_MM, SHIFT_MM, 3)
    return HeadPose(matrix_from(moved - turn @ centre, turn))


def _remaining_screw(post: Shape) -> Rod:
    """Return the part of a marker's post left in scalp and bone."""
    assert isinstance(post, Rod)
    remaining_mm = min(SCALP_MM + SCREW_IN_BONE_MM, post.length)
    start = shift_point(post.start, post.along, post.length - remaining_mm)
    return Rod(post.hu, start, post.along, remaining_mm, post.radius)


def _draw_streak(generator: np.random.Generator) -> Streak:
    return Streak(
        centre=(0.0, 0.0, 0.0),
        hu=float(generator.uniform(*STREAK_HU)),
        fall_mm=STREAK_FALL_MM,
        lobes=int(generator.choice(STREAK_LOBES)),
        phase_rad=float(generator.uniform(0.0, 2.0 * np.pi)),
        height_mm=1.0,
    )
