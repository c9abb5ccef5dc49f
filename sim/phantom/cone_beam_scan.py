"""Cone-beam scan of the clamped head during the operation, as an O-arm or a C-arm with a flat panel makes it.

Against the CT of the plan it has a smaller round field that truncates the head, isotropic voxels, values that
scatter lowers and cups, noise that is correlated along all three axes, screws and skull pins of metal, and
the head elsewhere in another orientation. The spheres are where they are in the theatre. Streaks are computed
slice by slice with parallel rays, as for a CT: the cone's own artefacts at the ends of the field are missing.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import radians, sqrt

import numpy as np

from sim.errors import BAD_SCENE
from sim.phantom.head.anatomy import AIR_HU, SkinMarker, side_cable
from sim.phantom.head.faced_layers import layers_of
from sim.phantom.head.obstacles import clamp
from sim.phantom.head.painting import edge_sigma_mm, paint
from sim.phantom.head.shapes import Ball, Rod, Shape, Values
from sim.phantom.postoperative_scan import HeadPose, PosedLayers, PosedShape
from sim.phantom.scan import RAMP_WIDTH, SKIN_MARGIN_MM, plain_scan, slice_noise
from sim.phantom.scanner.faults import Kernel
from sim.phantom.scanner.fine_painting import HALF_SIDE_MM, Patch, paint_patch
from sim.phantom.scanner.grid import CtGrid, centre_grid
from sim.phantom.scanner.metal_artefacts import (
    METAL_FROM_HU,
    METALS,
    STEEL,
    TITANIUM,
    MetalArtefacts,
    MetalPart,
)
from sim.world.noise import noise
from sim.world.rigid import Point, apply, as_point, matrix_from, rotation_from_vector
from sim.world.scene.model import CtProtocol, Fiducial, Scene

# 200 mm wide and 160 mm high, as an O-arm's; noise of a low-dose protocol of the head
PROTOCOL = CtProtocol(pixel_mm=0.5, slice_mm=0.5, columns=400, rows=400, slices=320, noise_HU=60.0)
KERNEL = Kernel(plane_sigma_mm=0.5, noise_side=0.45, name="CONE BEAM")
BLUR_ALONG_MM = 1.2  # box along z that makes the blur there about that within a slice
NOISE_ALONG = 0.5  # weight of the noise of each neighbouring slice
OUTSIDE_HU = -2048.0  # padding around the round field

GAIN = (0.80, 0.95)  # of all contrasts: scatter adds the same to all rays
CUPPING_HU = (60.0, 160.0)  # the head's middle is that much too dark
SHADING_HU = 25.0  # per term of a smooth field, one standard deviation
RIM_HU, RIM_MM = 150.0, 6.0  # where the field cuts the head: too bright, fading inwards

TURN_RAD = radians(20.0)  # largest rotation of the clamped head against the CT, per axis
AIM_MM = 8.0  # by which the field's middle misses the middle of the spheres, per axis, at most
AIM_DEPTH = 0.35  # of the way from the middle of the spheres to that of the head
PINS = 3  # of the clamp
AMALGAM = "amalgam"
STEEL_FROM_HU = 5000.0
SLICES_KEPT = 3


@dataclass(frozen=True)
class Detector:
    """Errors of the values of one scan."""

    gain: float
    cupping_HU: float
    shading_HU: tuple[float, ...]  # of `_shading_terms`


@dataclass(frozen=True, eq=False)
class ConeBeamScan:
    """Contents of a cone-beam scan in its own coordinates; its field's axis is z through the origin."""

    scene: Scene
    seed: int
    protocol: CtProtocol
    grid: CtGrid
    pose: HeadPose
    detector: Detector
    markers: tuple[SkinMarker, ...]  # mapped into the scan
    bodies: tuple[Shape, ...]  # all others
    metal: tuple[MetalPart, ...]

    @property
    def radius_mm(self) -> float:
        """Radius of the round field."""
        return 0.5 * self.grid.columns * self.grid.pixel_mm

    @cached_property
    def places(self) -> tuple[Point, ...]:
        """Centres of the spheres whose surroundings the grid shows in part."""
        grid = self.grid
        return tuple(
            centre
            for centre in (marker.fiducial.centre_ct_mm for marker in self.markers)
            if all(
                (part := grid.indices(axis, centre[axis] - HALF_SIDE_MM, centre[axis] + HALF_SIDE_MM)).start
                < part.stop
                for axis in range(3)
            )
        )

    def share_shown(self, marker: SkinMarker) -> float:
        """Return the share of a sphere's diameter that is in the field, by the side that lacks most."""
        radius = marker.fiducial.radius_mm
        x, y, z = marker.fiducial.centre_ct_mm
        half_mm = 0.5 * self.grid.slices * self.grid.slice_mm
        inside_mm = min(self.radius_mm - float(np.hypot(x, y)), half_mm - abs(z - self.grid.z_mm.mean()))
        return float(np.clip(0.5 + 0.5 * inside_mm / radius, 0.0, 1.0))


def draw_cone_beam(
    scene: Scene,
    spheres: Sequence[Fiducial],
    seed: int,
    *,
    protocol: CtProtocol = PROTOCOL,
    aim_mm: float = AIM_MM,
) -> ConeBeamScan:
    """Draw pose and detector of a scan of the scene's clamped head with these spheres, in the CT frame.

    `aim_mm` is the largest error of the aim per axis. Raises SIM-001 if no sphere is on the head.
    """
    if not spheres:
        raise BAD_SCENE("there is no sphere on the head to scan")
    generator = noise(seed, "cone beam", 0)
    head = scene.head.model_copy(update={"fiducials": tuple(spheres), "adhesives": ()})
    present = scene.model_copy(update={"head": head})
    pose = _draw_pose(present, aim_mm, generator)
    detector = Detector(
        float(generator.uniform(*GAIN)),
        float(generator.uniform(*CUPPING_HU)),
        tuple((SHADING_HU * generator.standard_normal(6)).tolist()),
    )
    anatomy = plain_scan(present).anatomy
    beside = set(side_cable(head))  # belongs to the room of the CT
    around = (
        *(one for one in anatomy.surroundings if one not in beside),
        *clamp(head, PINS, generator).shapes,
    )
    fillings = set(anatomy.fillings)
    bodies = [_into_scan(one, pose) for one in around]
    markers = tuple(_move_marker(one, pose) for one in anatomy.markers)
    metal = [
        MetalPart(
            there, METALS[AMALGAM if here in fillings else STEEL if here.hu >= STEEL_FROM_HU else TITANIUM]
        )
        for here, there in (
            *zip(around, bodies, strict=True),
            *((shape, shape) for marker in markers for shape in marker.shapes),
        )
        if isinstance(there, Rod | Ball) and there.hu >= METAL_FROM_HU
    ]
    return ConeBeamScan(
        scene=scene,
        seed=seed,
        protocol=protocol,
        grid=centre_grid(np.zeros(3), protocol),
        pose=pose,
        detector=detector,
        markers=markers,
        bodies=tuple(bodies),
        metal=tuple(metal),
    )


def _draw_pose(scene: Scene, aim_mm: float, generator: np.random.Generator) -> HeadPose:
    """Turn the head at random, and aim the field between the middle of the spheres and that of the head."""
    turn = rotation_from_vector(generator.uniform(-TURN_RAD, TURN_RAD, 3))
    head = scene.head
    spheres_mm = np.array([one.centre_ct_mm for one in head.fiducials]) @ turn.T
    middle_mm = 0.5 * (spheres_mm.min(axis=0) + spheres_mm.max(axis=0))
    aimed_at_mm = middle_mm + AIM_DEPTH * (turn @ np.array(head.centre_ct_mm) - middle_mm)
    return HeadPose(matrix_from(generator.uniform(-aim_mm, aim_mm, 3) - aimed_at_mm, turn))


def _into_scan(shape: Shape, pose: HeadPose) -> Shape:
    """Map a body into the scan; rods and balls stay what they are, since only those throw streaks."""
    if isinstance(shape, Rod):
        return pose.rod(shape)
    if isinstance(shape, Ball):
        return Ball(shape.hu, as_point(apply(pose.scan_from_head, shape.centre)), shape.radius)
    return PosedShape(shape.hu, shape, pose)


def _move_marker(marker: SkinMarker, pose: HeadPose) -> SkinMarker:
    fiducial = marker.fiducial
    moved = fiducial.model_copy(
        update={
            "centre_ct_mm": as_point(apply(pose.scan_from_head, fiducial.centre_ct_mm)),
            "post_ct": as_point(pose.scan_from_head[:3, :3] @ np.array(fiducial.post_ct)),
        }
    )
    return replace(marker, fiducial=moved, shapes=tuple(_into_scan(one, pose) for one in marker.shapes))


class ConeBeamPainter:
    """Paints the slices of a cone-beam scan in any order."""

    def __init__(self, scan: ConeBeamScan) -> None:
        self._scan, grid = scan, scan.grid
        head = scan.scene.head
        edge_mm = edge_sigma_mm(grid.pixel_mm, BLUR_ALONG_MM, KERNEL.plane_sigma_mm)
        self._edge_mm = RAMP_WIDTH * edge_mm
        self._layers = PosedLayers(layers_of(head, edge_mm), scan.pose)
        self._x, self._y = grid.x_mm.astype(np.float32), grid.y_mm.astype(np.float32)
        self._shapes = (*scan.bodies, *(shape for marker in scan.markers for shape in marker.shapes))
        self._sharp = PosedLayers(layers_of(head, 0.0), scan.pose)
        self._metal = MetalArtefacts(
            scan.metal, scan.places, grid, KERNEL, BLUR_ALONG_MM, scan.protocol.noise_HU
        )
        self._noise: OrderedDict[int, Values] = OrderedDict()
        distance_mm = np.hypot(self._x[None, :], self._y[:, None])
        self._outside = distance_mm > scan.radius_mm
        self._rim = np.float32(RIM_HU) * np.exp(
            (distance_mm - np.float32(scan.radius_mm)) / np.float32(RIM_MM)
        )
        self._patches: tuple[Patch, ...] | None = None

    def paint_patches(self) -> None:
        """Paint the surroundings of all spheres finely; `paint` does it for the first slice otherwise."""
        self._patches = tuple(
            paint_patch(place, self._shapes, self._sharp, self._scan.grid, KERNEL, BLUR_ALONG_MM)
            for place in self._scan.places
        )

    def paint(self, number: int) -> Values:
        """Paint one slice in HU (rows, columns), with all errors of the scanner."""
        if self._patches is None:
            self.paint_patches()
        image, inside = self._clean(number)
        self._metal.add(image, number, noise(self._scan.seed, "cone beam metal", number))
        z_mm = float(self._scan.grid.z_mm[number])
        detector = self._scan.detector
        image -= np.float32(AIR_HU)
        image *= np.float32(detector.gain)
        image += np.float32(AIR_HU)
        image -= np.float32(detector.cupping_HU) * inside
        image += self._rim * (inside > 0.0)
        image += self._shading(z_mm)
        image += self._correlated_noise(number)
        image[self._outside] = OUTSIDE_HU
        return image

    def _clean(self, number: int) -> tuple[Values, Values]:
        """Return the slice without errors, and the depth in the head: 0 at the skin, 1 in the middle."""
        grid = self._scan.grid
        z_mm = float(grid.z_mm[number])
        image = np.full((grid.rows, grid.columns), AIR_HU, dtype=np.float32)
        depth = np.zeros_like(image)
        low, high = self._layers.bounds(SKIN_MARGIN_MM)
        columns, rows = (grid.indices(axis, low[axis], high[axis]) for axis in (0, 1))
        if low[2] <= z_mm <= high[2]:
            x, y, z = self._x[None, columns], self._y[rows, None], np.full((1, 1), z_mm, dtype=np.float32)
            image[rows, columns] = self._layers.hu_at(x, y, z)
            head = self._scan.scene.head
            shares = [
                (one - np.float32(centre)) / np.float32(axis)
                for one, centre, axis in zip(
                    self._scan.pose.to_head(x, y, z), head.centre_ct_mm, head.semi_axes_mm, strict=True
                )
            ]
            depth[rows, columns] = np.maximum(1.0 - sum(share * share for share in shares), 0.0)
        axes = (self._x, self._y, np.array([z_mm], dtype=np.float32))
        for shape in self._shapes:
            paint(image[None], axes, shape, self._edge_mm)
        for patch in self._patches or ():
            if patch.slices.start <= number < patch.slices.stop:
                image[patch.rows, patch.columns] = patch.hu[number - patch.slices.start]
        return image, depth

    def _shading(self, z_mm: float) -> Values:
        x, y = self._x[None] / self._scan.radius_mm, self._y[:, None] / self._scan.radius_mm
        z = np.full((1, 1), z_mm / self._scan.radius_mm, dtype=np.float32)
        found = np.zeros((len(self._y), len(self._x)), dtype=np.float32)
        terms = (x, y, z, x * x, y * y, x * y)
        for weight, term in zip(self._scan.detector.shading_HU, terms, strict=True):
            found += np.float32(weight) * term
        return found

    def _correlated_noise(self, number: int) -> Values:
        scale = 1.0 / sqrt(1.0 + 2.0 * NOISE_ALONG**2)
        low, middle, high = (self._draw_noise(number + step) for step in (-1, 0, 1))
        found: Values = np.float32(scale) * (middle + np.float32(NOISE_ALONG) * (low + high))
        return found

    def _draw_noise(self, number: int) -> Values:
        drawn = self._noise.get(number)
        if drawn is None:
            grid, generator = self._scan.grid, noise(self._scan.seed, "cone beam noise", number + 1)
            drawn = self._noise[number] = slice_noise(
                generator, (grid.rows, grid.columns), grid.pixel_mm, self._scan.protocol.noise_HU, KERNEL
            )
            while len(self._noise) > SLICES_KEPT:
                self._noise.popitem(last=False)
        return drawn
