"""The postoperative scan: the same head in another pose, without markers, with what was inserted."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.anatomy import SCREW_IN_BONE_MM, draw_anatomy, shifted, side_cable
from sim.phantom.head.layers import AIR_HU, SCALP_MM, HeadLayers
from sim.phantom.head.shapes import Ball, Rod, Shape, Values
from sim.phantom.head.streaks import Streak, add_filling_streaks, add_streak
from sim.phantom.postoperative.instruments import Instrument, Kind
from sim.phantom.postoperative.posed_head import HeadPose, PosedLayers, PosedShape
from sim.phantom.postoperative.thin_rod import middle_at, paint_rod
from sim.phantom.scanner import blur
from sim.phantom.scanner.grid import ORIGIN_DIGITS, CtGrid
from sim.phantom.scanner.painting import paint
from sim.phantom.scanner.slice_painter import RAMP_WIDTH, SKIN_MARGIN_MM, slice_noise
from sim.world.noise import noise
from sim.world.rigid import apply, matrix_from, rotation_from_vector
from sim.world.scene.model import CtProtocol, Scene

TURN_RAD = radians(10.0)  # of the head between the two scans, per axis, either way
SHIFT_MM = 30.0
STREAK_HU = (200.0, 400.0)  # next to the metal
STREAK_LOBES = (4, 5, 6, 7)
STREAK_FALL_MM = 2.5
POST_PLACE = 2  # index of the post among a marker's bodies, see `marker_on_foot`


@dataclass(frozen=True, eq=False)
class PostoperativeScan:
    """Everything to paint, in coordinates of the new scan."""

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
        """HU (rows, columns) of one slice with its noise."""
        grid = self.grid
        z_mm = float(grid.z_mm[number])
        x, y = grid.x_mm.astype(np.float32), grid.y_mm.astype(np.float32)
        image = np.full((grid.rows, grid.columns), AIR_HU, dtype=np.float32)
        self._paint_head(image, x, y, z_mm)
        axes, edge_mm = (x, y, np.array([z_mm], dtype=np.float32)), self._edge_mm
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

    @property
    def _edge_mm(self) -> float:
        return RAMP_WIDTH * blur.edge_sigma_mm(self.grid.pixel_mm, self.grid.slice_mm)

    def _paint_head(self, image: Values, x: Values, y: Values, z_mm: float) -> None:
        low, high = self.head.bounds(SKIN_MARGIN_MM)
        columns, rows = (self.grid.indices(axis, low[axis], high[axis]) for axis in (0, 1))
        z = np.full((1, 1), z_mm, dtype=np.float32)
        image[rows, columns] = self.head.at(x[None, columns], y[rows, None], z)


def draw_scan(
    scene: Scene, instruments: tuple[Instrument, ...], seed: int, protocol: CtProtocol | None = None
) -> PostoperativeScan:
    """The head of a scene in a pose drawn from `seed`: spheres and bases removed, screws left in the bone."""
    generator = noise(seed, "postoperative pose", 0)
    protocol = protocol or scene.ct
    pose = _draw_pose(scene, generator)
    grid = _grid(scene, pose, protocol)
    head = scene.head
    anatomy = draw_anatomy(scene)
    beside = set(side_cable(head))  # belongs to the scanner's room
    screws = (_screw(marker.shapes[POST_PLACE]) for marker in anatomy.markers)
    edge_mm = blur.edge_sigma_mm(grid.pixel_mm, grid.slice_mm)
    return PostoperativeScan(
        scene=scene,
        seed=seed,
        protocol=protocol,
        grid=grid,
        pose=pose,
        head=PosedLayers(HeadLayers(head.centre_ct_mm, head.semi_axes_mm, edge_mm), pose),
        bodies=tuple(
            PosedShape(shape, pose) for shape in (*anatomy.surroundings, *screws) if shape not in beside
        ),
        fillings=tuple(
            Ball(one.hu, _three(apply(pose.scan_from_head, one.centre)), one.radius)
            for one in anatomy.fillings
        ),
        rods=tuple(pose.rod(one.rod(head)) for one in instruments),
        streaks=tuple(_streak(generator) if one.kind is not Kind.DRILL_HOLE else None for one in instruments),
    )


def _draw_pose(scene: Scene, generator: np.random.Generator) -> HeadPose:
    turn = rotation_from_vector(generator.uniform(-TURN_RAD, TURN_RAD, 3))
    centre = np.array(scene.head.centre_ct_mm)
    moved = centre + generator.uniform(-SHIFT_MM, SHIFT_MM, 3)
    return HeadPose(matrix_from(moved - turn @ centre, turn))


def _grid(scene: Scene, pose: HeadPose, protocol: CtProtocol) -> CtGrid:
    """The protocol's field, centred on the head."""
    counts = np.array([protocol.columns, protocol.rows, protocol.slices])
    spacing = np.array([protocol.pixel_mm, protocol.pixel_mm, protocol.slice_mm])
    middle = apply(pose.scan_from_head, scene.head.centre_ct_mm)
    x, y, z = (round(float(value), ORIGIN_DIGITS) for value in middle - (counts - 1) * spacing / 2)
    return CtGrid(
        (x, y, z), protocol.pixel_mm, protocol.slice_mm, protocol.columns, protocol.rows, protocol.slices
    )


def _screw(post: Shape) -> Rod:
    """The remaining part of a marker's post, in scalp and bone."""
    assert isinstance(post, Rod)
    left_mm = min(SCALP_MM + SCREW_IN_BONE_MM, post.length)
    start = shifted(post.start, post.along, post.length - left_mm)
    return Rod(post.hu, start, post.along, left_mm, post.radius)


def _streak(generator: np.random.Generator) -> Streak:
    return Streak(
        centre=(0.0, 0.0, 0.0),
        hu=float(generator.uniform(*STREAK_HU)),
        fall_mm=STREAK_FALL_MM,
        lobes=int(generator.choice(STREAK_LOBES)),
        phase_rad=float(generator.uniform(0.0, 2.0 * np.pi)),
        height_mm=1.0,
    )


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
