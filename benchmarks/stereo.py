"""Spheres in rendered pictures: cost and error of our measurement beside what is usually tried first.

The pictures are the simulated cameras' own, full frames with post, grain, shading, blur and noise. The
calibration is the truth, so what is left is the measurement's own error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.contest import cpu_of
from benchmarks.figures import Figure, compared
from procedures.relocalization import SphereImage, measure_sphere, triangulate
from procedures.relocalization.camera import Camera
from ronna_hw.calibration import CameraCalibration, PoseRecord, StereoHeadCalibration
from ronna_hw.frames import Frame
from sim.basler.optics.canvas import Area
from sim.basler.optics.lens import Lens
from sim.basler.optics.picture import Optics
from sim.basler.optics.sensor import Sensor
from sim.basler.optics.sphere import Sphere
from sim.theatre.built_in import built_in_scene
from sim.theatre.noise import noise
from sim.theatre.rigid import matrix_of, rotation_towards
from sim.theatre.scene import CameraTruth, Scene

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

SPHERES = 14
EXPOSURE_US = 2000.0  # the driver's default
GAIN_RAW, BLACK_LEVEL_RAW = 100, 32
RADIUS_MM = 5.75
REACH_MM = 2.5  # of the sphere from the tool centre point: where the servo sees it
TILT = 0.5  # of the post against the tool axis
RADIUS_TOLERANCE = 0.15
OURS, HOUGH, CENTROID = "measure_sphere", "OpenCV HoughCircles", "threshold and centroid"


@dataclass(frozen=True)
class Pair:
    """One sphere in both cameras: pictures, true outline centres, and its true place in the tool frame."""

    pictures: tuple[Picture, Picture]
    centres_px: tuple[Array, Array]
    radii_px: tuple[float, float]
    centre_mm: Array


def measure() -> list[Figure]:
    """Measurement per picture, then the point in space."""
    scene = built_in_scene("default", seed=21)
    pairs = _pairs(scene)
    return [*_per_picture(pairs), *_in_space(scene, pairs)]


def _per_picture(pairs: list[Pair]) -> list[Figure]:
    methods: dict[str, Callable[[Picture, float], Array]] = {
        OURS: lambda picture, _radius: np.array(measure_sphere(picture).centre_px),
        HOUGH: _hough,
        CENTROID: _centroid,
    }
    cpu_s: dict[str, list[float]] = {name: [] for name in methods}
    errors_px: dict[str, list[float]] = {name: [] for name in methods}
    for pair in pairs:
        for picture, truth, radius in zip(pair.pictures, pair.centres_px, pair.radii_px, strict=True):
            for name, method in methods.items():
                found: list[Array] = []
                cpu_s[name].append(
                    cpu_of(lambda m=method, p=picture, r=radius, f=found: f.append(m(p, r)))  # type: ignore[misc]
                )
                errors_px[name].append(float(np.linalg.norm(found[0] - truth)))
    return [
        *compared("CPU per full frame", "ms", cpu_s, CENTROID, scale=1e3),
        *compared("error of the centre, median", "px", errors_px, CENTROID),
        *(
            Figure("error of the centre, rms", name, float(np.sqrt(np.mean(np.square(values)))), "px")
            for name, values in errors_px.items()
        ),
    ]


def _in_space(scene: Scene, pairs: list[Pair]) -> list[Figure]:
    calibration = _perfect(scene)
    cameras = (
        Camera(calibration.left, Frame.CAMERA_LEFT),
        Camera(calibration.right, Frame.CAMERA_RIGHT),
    )
    ours, bare = "triangulate", "OpenCV triangulatePoints"
    errors_mm: dict[str, list[float]] = {ours: [], bare: []}
    cpu_s: dict[str, list[float]] = {ours: [], bare: []}
    for pair in pairs:
        left, right = (measure_sphere(picture) for picture in pair.pictures)
        outlines = (left, right)
        point = triangulate(left, right, calibration).position_mm
        errors_mm[ours].append(float(np.linalg.norm(point - pair.centre_mm)))
        errors_mm[bare].append(float(np.linalg.norm(_triangulated(cameras, outlines) - pair.centre_mm)))
        cpu_s[ours].append(cpu_of(lambda a=left, b=right: triangulate(a, b, calibration), 10))  # type: ignore[misc]
        cpu_s[bare].append(cpu_of(lambda o=outlines: _triangulated(cameras, o), 10))  # type: ignore[misc]
    rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors_mm.items()}
    return [
        *(
            Figure(
                "point error, true calibration, rms",
                name,
                rms[name] * 1e3,
                "µm",
                rms[name] / rms[bare] if name != bare else None,
                bare if name != bare else "",
            )
            for name in rms
        ),
        *compared("CPU per point", "ms", cpu_s, bare, scale=1e3),
    ]


def _pairs(scene: Scene) -> list[Pair]:
    generator = np.random.default_rng(3)
    optics = [Optics(camera, scene.seed) for camera in (scene.left, scene.right)]
    pairs = []
    for number in range(SPHERES):
        place = generator.uniform(-REACH_MM, REACH_MM, 3)
        post = np.array([*generator.uniform(-TILT, TILT, 2), -1.0])
        pictures, centres, radii = [], [], []
        for camera, optic in zip((scene.left, scene.right), optics, strict=True):
            pose = matrix_of(camera.camera_from_tool)
            centre = pose[:3, :3] @ place + pose[:3, 3]
            rotation = pose[:3, :3] @ rotation_towards(tuple(post), (1.0, 0.0, 0.0))
            sphere = Sphere(centre, RADIUS_MM, rotation, number % 5)
            pictures.append(_picture(camera, optic, sphere, scene.seed, number))
            middle, radius = _true_outline(optic.lens, sphere)
            centres.append(middle)
            radii.append(radius)
        pairs.append(Pair((pictures[0], pictures[1]), (centres[0], centres[1]), (radii[0], radii[1]), place))
    return pairs


def _picture(camera: CameraTruth, optics: Optics, sphere: Sphere, seed: int, number: int) -> Picture:
    width, height = camera.sensor_px
    light = optics.light_on(Area(0, 0, width, height), [sphere])
    pixels = Sensor(camera.read_noise_electrons, camera.full_well_electrons).read(
        light,
        exposure_us=EXPOSURE_US,
        gain_raw=GAIN_RAW,
        black_level_raw=BLACK_LEVEL_RAW,
        bits=8,
        noise=noise(seed, f"camera {camera.serial}", number),
    )
    return np.asarray(pixels, dtype=np.uint8)


def _true_outline(lens: Lens, sphere: Sphere) -> tuple[Array, float]:
    """Centre and mean radius, px, of the ellipse through the projected points of the outline."""
    outline = lens.project(sphere.outline_mm())
    middle = outline.mean(axis=0)
    x, y = (outline - middle).T
    conic = np.column_stack([x * x, x * y, y * y, x, y])
    a, b, c, d, e = np.linalg.lstsq(conic, np.ones(len(x)), rcond=None)[0]
    centre = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
    return middle + centre, float(np.hypot(x - centre[0], y - centre[1]).mean())


def _hough(picture: Picture, radius_px: float) -> Array:
    circles = cv2.HoughCircles(
        cv2.GaussianBlur(picture, (5, 5), 0),
        cv2.HOUGH_GRADIENT,
        dp=1,
        minDist=2 * radius_px,
        param1=100,
        param2=15,
        minRadius=round(radius_px * (1 - RADIUS_TOLERANCE)),
        maxRadius=round(radius_px * (1 + RADIUS_TOLERANCE)),
    )
    if circles is None:
        raise RuntimeError("HoughCircles found nothing")
    return np.asarray(circles, dtype=float).reshape(-1, 3)[0, :2]


def _centroid(picture: Picture, _radius_px: float) -> Array:
    _, mask = cv2.threshold(picture, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, _, statistics, centres = cv2.connectedComponentsWithStats(mask)
    largest = 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))
    return np.asarray(centres[largest], dtype=float)


def _triangulated(cameras: tuple[Camera, Camera], outlines: tuple[SphereImage, SphereImage]) -> Array:
    """The bare way: outline centres, distortion removed, no perspective bias, linear least squares."""
    rays = [camera.undistorted(o.centre_px)[:, None] for camera, o in zip(cameras, outlines, strict=True)]
    poses = [np.column_stack([camera.rotation, camera.translation_mm]) for camera in cameras]
    point = cv2.triangulatePoints(poses[0], poses[1], rays[0], rays[1]).ravel()
    return np.asarray(point[:3] / point[3], dtype=float)


def _perfect(scene: Scene) -> StereoHeadCalibration:
    now = datetime.now(UTC)
    identity = PoseRecord(translation_mm=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
    left, right = (
        CameraCalibration(
            serial=camera.serial,
            focal_px=camera.focal_px,
            principal_point_px=camera.principal_point_px,
            distortion=camera.distortion,
            camera_from_tool=camera.camera_from_tool,
        )
        for camera in (scene.left, scene.right)
    )
    return StereoHeadCalibration(
        identifier="truth",
        created=now,
        expires=now + timedelta(days=1),
        made_by="the scene",
        stated_error_mm=0.0,
        flange_from_tool=identity,
        left=left,
        right=right,
    )
