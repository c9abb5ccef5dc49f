"""A laser line on a simulated face: cost of its points, of its pictures, and of the rays that draw it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from benchmarks.figures import Figure, compare_samples, measure_cpu_s, run_contest
from benchmarks.stereo_head.head_looks import TrueHead
from procedures.relocalization.grey_image import AreaImage
from procedures.relocalization.laser_line import measure_line
from procedures.relocalization.line_points import LinePoints, triangulate_line
from sim.basler.camera.photographer import Photographer
from sim.basler.settings import CameraSettings
from sim.world.options import Carrier
from sim.world.rigid import inverse, matrix_from, matrix_of, rotation_towards
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.skin import skin_in_theatre
from sim.world.world import ArmState, World

POINTS, BASELINE = "both pictures to points", "brightest column of each row, both pictures"
SEED = 9  # whose skin has moved since the CT
EXPOSURE_US = 2000
OUTWARDS = np.array([0.2, -1.0, 0.1]) / np.linalg.norm([0.2, -1.0, 0.1])  # from the head's centre: the brow
AWAY_MM = 300.0  # of the rays' origins
RAYS = 1000
ROUNDS, SMALLEST_ROUNDS = 60, 1
POINTS_MS, PICTURE_MS = 5.0, 40.0


def measure(smallest: bool = False) -> list[Figure]:
    rounds = SMALLEST_ROUNDS if smallest else ROUNDS
    world = World.create(draw_scene("mini", seed=SEED, fiducials=Carrier.SURFACE), paced=False)
    scene = world.scene
    _aim_at_brow(world)
    record = TrueHead(scene).record
    dark = CameraSettings(exposure_us=EXPOSURE_US).frame()
    cameras = [Photographer(world, truth) for truth in (scene.left, scene.right)]
    lit = replace(dark, line_lit=True)
    pairs = [[_as_image(camera.triggered(frame, 1)) for frame in (lit, dark)] for camera in cameras]

    def find_points() -> LinePoints:
        left, right = (measure_line(*pair) for pair in pairs)
        return triangulate_line(left, right, record)

    def find_columns() -> None:
        for with_line, without in pairs:
            cv2.subtract(with_line.pixels, without.pixels).argmax(axis=1)

    samples = run_contest(
        {POINTS: lambda: measure_cpu_s(find_points), BASELINE: lambda: measure_cpu_s(find_columns)}, rounds
    )
    pictures_s = [measure_cpu_s(lambda: cameras[0].triggered(lit, 1)) for _ in range(rounds)]
    skin = skin_in_theatre(scene.head)
    origins, ways = _rays(np.array(scene.head.centre_ct_mm))
    rays_s = [measure_cpu_s(lambda: skin.cast(origins, ways, 2.0 * AWAY_MM)) for _ in range(rounds)]
    points, baseline = compare_samples("CPU per laser line, full frames", "ms", samples, BASELINE, scale=1e3)
    found = {"points": float(len(find_points().points_mm))}
    return [
        replace(points, more=found).at_most(POINTS_MS),
        baseline,
        Figure("CPU per picture of a laser line", "simulator", _median_ms(pictures_s), "ms").at_most(
            PICTURE_MS
        ),
        Figure(f"CPU per {RAYS} rays onto skin that moved", "simulator", _median_ms(rays_s), "ms"),
    ]


def _aim_at_brow(world: World) -> None:
    scene = world.scene
    start = np.array(scene.head.centre_ct_mm) + AWAY_MM * OUTWARDS
    (away_mm,) = skin_in_theatre(scene.head).cast(start[None], -OUTWARDS[None], 2.0 * AWAY_MM)
    ct_from_tool = matrix_from(start - away_mm * OUTWARDS, rotation_towards(-OUTWARDS, (0.0, 0.0, 1.0)))
    tool = matrix_of(scene.head.robot_from_ct) @ ct_from_tool
    world.publish_arm(
        ArmState((0.0,) * 6, tool @ inverse(matrix_of(scene.mount.flange_from_tool_true)), 1, True)
    )


def _as_image(drawn: bytes) -> AreaImage:
    settings = CameraSettings()
    return AreaImage(np.frombuffer(drawn, np.uint8).reshape(settings.height, settings.width))


def _rays(centre_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw rays from all around to near the head's centre."""
    generator = np.random.default_rng(SEED)
    origins = generator.standard_normal((RAYS, 3))
    origins = centre_mm + AWAY_MM * origins / np.linalg.norm(origins, axis=1, keepdims=True)
    ways = centre_mm + generator.uniform(-40.0, 40.0, (RAYS, 3)) - origins
    return origins, ways / np.linalg.norm(ways, axis=1, keepdims=True)


def _median_ms(seconds: list[float]) -> float:
    return 1e3 * float(np.median(seconds))
