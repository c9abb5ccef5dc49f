"""Fusion of an MR with the CT against phantom ground truth: error at targets, and what is refused.

Each phantom is a head of the default scene, with an MR of another contrast, pose (30 mm and 20 degrees off),
noise, shading and distortion; the largest displacement of the distortion grows from phantom to phantom up to
1 mm. Run from the repository root:

    python -m benchmarks.scans.fusion --phantoms 20
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from benchmarks.scans.postoperative import paint_before
from procedures.fusion.record import Fusion
from procedures.fusion.registration import fuse_series
from procedures.imaging.volume import Volume, VoxelGeometry
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError
from sim.phantom.mr_scan import DISTORTION_MM, NOISE, MrScan, draw_mr
from sim.world.noise import noise
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import MINI_CT, draw_scene

MR = CtProtocol(pixel_mm=1.0, slice_mm=1.5, columns=256, rows=256, slices=160, noise_HU=NOISE)
TARGETS, DEEPEST_SHARE = 100, 0.6  # of the semi-axes: where targets lie
GOAL_MM = 0.5


def paint_mr(scan: MrScan) -> Volume:
    """Paint an MR as it would be read from its files."""
    grid = scan.grid
    voxels = np.stack([np.rint(scan.paint(number)) for number in range(grid.slices)]).astype(np.int16)
    spacing = np.array([grid.slice_mm, grid.pixel_mm, grid.pixel_mm])
    geometry = VoxelGeometry(voxels.shape, np.array(grid.origin_mm), np.eye(3)[:, ::-1], spacing)
    return Volume(voxels, geometry, "1.2.3", "1.2.3")


def draw_targets(scene: Scene, seed: int) -> Array:
    """Draw targets (n, 3) mm within the brain, in the CT."""
    generator = noise(seed, "fusion targets", 0)
    unit = generator.standard_normal((TARGETS, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    shares = unit * DEEPEST_SHARE * generator.uniform(size=(TARGETS, 1)) ** (1.0 / 3.0)
    return np.asarray(np.array(scene.head.centre_ct_mm) + shares * np.array(scene.head.semi_axes_mm))


def rms_at_targets_mm(fusion: Fusion, scan: MrScan, targets_mm: Array) -> float:
    """Return the rms distance of targets, as seen in the MR and mapped into the CT, from where they are."""
    mapped = fusion.map_to_ct(scan.shown_mm(targets_mm))
    return float(np.sqrt(np.square(mapped - targets_mm).sum(axis=1).mean()))


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--phantoms", type=int, default=20)
    options.add_argument("--first", type=int, default=0)
    arguments = options.parse_args()
    wrong, fused = 0, []
    print("phantom, distortion mm: error mm rms, expected mm", flush=True)
    for seed in range(arguments.first, arguments.first + arguments.phantoms):
        scene = draw_scene("default", seed=seed).model_copy(update={"ct": MINI_CT})
        distortion_mm = DISTORTION_MM * (seed % 20 + 1) / 20
        scan = draw_mr(scene, seed, protocol=MR, distortion_mm=distortion_mm)
        try:
            fusion = fuse_series(paint_before(scene), paint_mr(scan), "MR")
        except RonnaError as refused:
            print(f"{seed} {distortion_mm:.2f} {refused.code} {refused.what}", flush=True)
            continue
        error_mm = rms_at_targets_mm(fusion, scan, draw_targets(scene, seed))
        fused.append(error_mm)
        wrong += error_mm > GOAL_MM
        print(f"{seed} {distortion_mm:.2f}: {error_mm:.3f} {fusion.expected_mm:.3f}", flush=True)
    print(f"fused {len(fused)} of {arguments.phantoms}; off by more than {GOAL_MM} mm rms: {wrong}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
