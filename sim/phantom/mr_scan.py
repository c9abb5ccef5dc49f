"""MR scan of a phantom's head: another contrast, pose and field, and the distortions of such a scanner.

T1-weighted: fat and white matter are bright, cortical bone, air and metal dark. The markers are missing, as
the MR is taken before they are implanted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import radians

import numpy as np

from sim.phantom.head.anatomy import (
    AIR_HU,
    CSF_HU,
    ENAMEL_HU,
    JAW_HU,
    LAYERS,
    METAL_HU,
    draw_anatomy,
    side_cable,
)
from sim.phantom.head.faced_layers import Layers, layers_of
from sim.phantom.head.painting import edge_sigma_mm
from sim.phantom.head.shapes import Shape, Values
from sim.phantom.postoperative_scan import HeadPose, PosedLayers
from sim.phantom.scan import RAMP_WIDTH
from sim.phantom.scanner.grid import CtGrid, centre_grid
from sim.world.noise import noise
from sim.world.rigid import Array, apply, inverse, matrix_from, rotation_from_vector
from sim.world.scene.model import CtProtocol, Scene

# Intensity of each layer of `LAYERS`, from the skin inwards; 1000 would be fat beside the coil.
INTENSITIES = (420.0, 950.0, 380.0, 25.0, 480.0, 25.0, 120.0, 430.0, 620.0)
OF_BODIES = {AIR_HU: 5.0, CSF_HU: 120.0, ENAMEL_HU: 15.0, JAW_HU: 500.0, METAL_HU: 0.0}
AIR = 0.0
NOISE = 25.0  # of each channel: a signal-to-noise ratio of 25 in white matter, as at 1.5 T
SHADING = 0.3  # of the coil's field: largest relative change towards the skin, as a rule 0.2 to 0.4
SHIFT_MM, TURN_RAD = 30.0, radians(20.0)  # of the head, against its place in the CT
DISTORTION_MM = 1.0  # largest displacement at the skin: a scanner whose gradients are corrected in 3-D
PROTOCOL = CtProtocol(pixel_mm=1.0, slice_mm=1.2, columns=256, rows=256, slices=200, noise_HU=NOISE)
MONOMIALS = tuple(
    (a, b, c) for a in range(4) for b in range(4) for c in range(4) if 2 <= a + b + c <= 3
)  # of the distortion, in shares of the semi-axes: a field without a rigid part at the head's centre
SKIN_POINTS = 500
AROUND_MM = 6.0  # beyond the skin: its blur and displacement
FARTHEST_SHARE = 1.2  # of the semi-axes: beyond, there is only air
STILL_MM = 1e-4
MOST_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class MrScan:
    """Contents of an MR scan in its own coordinates, with its true pose and distortion."""

    scene: Scene
    seed: int
    protocol: CtProtocol
    grid: CtGrid
    pose: HeadPose
    weights_mm: Array  # (monomials, 3): true place minus shown place, in the head's axes
    shading: Array  # (3,), of the head's coordinates

    def paint(self, number: int) -> Values:
        """Paint one slice (rows, columns) of magnitudes, with noise and shading."""
        grid = self.grid
        image = np.full((grid.rows, grid.columns), AIR, dtype=np.float32)
        low, high = PosedLayers(self._layers, self.pose).bounds(AROUND_MM)
        if low[2] <= grid.z_mm[number] <= high[2]:
            columns, rows = (grid.indices(axis, low[axis], high[axis]) for axis in (0, 1))
            image[rows, columns] = self._paint_head(columns, rows, float(grid.z_mm[number]))
        generator = noise(self.seed, "mr", number)
        real, imaginary = generator.standard_normal((2, *image.shape), dtype=np.float32) * np.float32(NOISE)
        magnitude: Values = np.hypot(image + real, imaginary)
        return magnitude

    def _paint_head(self, columns: slice, rows: slice, z_mm: float) -> Values:
        x, y = self.grid.x_mm[columns].astype(np.float32), self.grid.y_mm[rows].astype(np.float32)
        z = np.full((1, 1), z_mm, dtype=np.float32)
        head_mm = np.stack(np.broadcast_arrays(*self.pose.to_head(x[None], y[:, None], z)), axis=-1)
        true_mm = head_mm + self.displacement_mm(head_mm)
        u, v, w = np.moveaxis(true_mm, -1, 0)
        image = self._layers.hu_at(u, v, w)
        low, high = true_mm.min(axis=(0, 1)), true_mm.max(axis=(0, 1))
        for shape in self._bodies:
            least, most = shape.bounds()
            if (np.array(most) >= low - self._edge_mm).all() and (
                np.array(least) <= high + self._edge_mm
            ).all():
                cover = np.clip(shape.depth(u, v, w) / np.float32(self._edge_mm) + np.float32(0.5), 0.0, 1.0)
                image = image + (np.float32(OF_BODIES[shape.hu]) - image) * cover
        shaded: Values = image * np.exp(self._shares(head_mm) @ self.shading.astype(np.float32))
        return shaded

    def displacement_mm(self, head_mm: Array) -> Array:
        """Return true place minus shown place, (..., 3) mm, of shown places (..., 3) in the head's frame."""
        shares = self._shares(head_mm)
        squares = shares * shares
        powers = (np.ones_like(shares), shares, squares, squares * shares)
        found = np.zeros_like(shares)
        for (a, b, c), weight in zip(MONOMIALS, self.weights_mm.astype(shares.dtype), strict=True):
            found += (powers[a][..., 0] * powers[b][..., 1] * powers[c][..., 2])[..., None] * weight
        return found

    def shown_mm(self, places_mm: Array) -> Array:
        """Return where places (..., 3) mm of the head, in the CT's frame, are shown in this scan."""
        places = np.asarray(places_mm, dtype=float)
        shown = places.copy()
        for _ in range(MOST_ROUNDS):
            before, shown = shown, places - self.displacement_mm(shown)
            if np.abs(shown - before).max() < STILL_MM:
                break
        return apply(self.pose.scan_from_head, shown)

    def _shares(self, head_mm: Array) -> Array:
        """Return positions in the head as shares of its semi-axes, held at its neighbourhood."""
        head = self.scene.head
        kind = head_mm.dtype
        shares = (head_mm - np.array(head.centre_ct_mm, kind)) / np.array(head.semi_axes_mm, kind)
        return np.asarray(np.clip(shares, -FARTHEST_SHARE, FARTHEST_SHARE))

    @cached_property
    def _edge_mm(self) -> float:
        return RAMP_WIDTH * edge_sigma_mm(self.grid.pixel_mm, self.grid.slice_mm)

    @cached_property
    def _layers(self) -> Layers:
        layers = tuple((mm, value) for (mm, _), value in zip(LAYERS, INTENSITIES, strict=True))
        return layers_of(self.scene.head, self._edge_mm / RAMP_WIDTH, layers=layers, air=AIR)

    @cached_property
    def _bodies(self) -> tuple[Shape, ...]:
        beside = set(side_cable(self.scene.head))  # belongs to the CT's room
        return tuple(one for one in draw_anatomy(self.scene).surroundings if one not in beside)


def draw_mr(
    scene: Scene,
    seed: int,
    *,
    protocol: CtProtocol = PROTOCOL,
    shift_mm: float = SHIFT_MM,
    turn_rad: float = TURN_RAD,
    distortion_mm: float = DISTORTION_MM,
) -> MrScan:
    """Draw an MR of a scene's head, shifted and turned by these amounts in random directions."""
    generator = noise(seed, "mr scan", 0)
    centre = np.array(scene.head.centre_ct_mm)
    turn = rotation_from_vector(turn_rad * _draw_direction(generator))
    moved = centre + shift_mm * _draw_direction(generator)
    pose = HeadPose(matrix_from(moved - turn @ centre, turn))
    weights_mm = generator.standard_normal((len(MONOMIALS), 3))
    shading = generator.uniform(-SHADING, SHADING, 3)
    scan = MrScan(scene, seed, protocol, centre_grid(moved, protocol), pose, weights_mm, shading)
    skin = _draw_skin(scene)
    largest = float(np.linalg.norm(scan.displacement_mm(skin), axis=-1).max())
    return MrScan(scene, seed, protocol, scan.grid, pose, weights_mm * (distortion_mm / largest), shading)


def ct_from_mr(scan: MrScan) -> Array:
    """Return the true rigid pose (4, 4) CT <- MR, without the distortion."""
    return inverse(scan.pose.scan_from_head)


def _draw_direction(generator: np.random.Generator) -> Array:
    direction = generator.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction))


def _draw_skin(scene: Scene) -> Array:
    """Return points (n, 3) mm on the head's skin, evenly spread by the golden angle."""
    number = np.arange(SKIN_POINTS)
    height = 1.0 - 2.0 * (number + 0.5) / SKIN_POINTS
    radius, angle = np.sqrt(1.0 - height**2), np.pi * (3.0 - 5.0**0.5) * number
    unit = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return np.asarray(np.array(scene.head.centre_ct_mm) + unit * np.array(scene.head.semi_axes_mm))
