"""Rendered stereo pairs of a sphere with complete ground truth, for evaluating the measurement.

The images are the simulated cameras' own, with post, grain, shading, blur and noise. The calibration is the
truth, so only the measurement's own error remains.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arrays import Array
from ronna_hw.calibration import CameraCalibration, PoseRecord, StereoHeadCalibration
from ronna_hw.plausible import FINEST_MM
from sim.basler.optics.canvas import Area, Lens
from sim.basler.optics.film import Stain, draw_stains
from sim.basler.optics.picture import Glare, LensOptics, Occluder, PictureDisturbance
from sim.basler.optics.sensor import Sensor
from sim.basler.optics.sphere import DrawnSphere
from sim.world.noise import noise
from sim.world.rigid import matrix_of, rotation_towards
from sim.world.scene.model import CameraTruth, Scene
from sim.world.scene.named_scenes import draw_scene

Picture = NDArray[np.uint8]

EXPOSURE_US = 2000.0  # the driver's default
GAIN_RAW, BLACK_LEVEL_RAW = 100, 32
RADIUS_MM = 5.75
FILMS = 5  # different grains
CENTRED_MM = 0.05  # where the servo ends
SERVO_MM = 2.5  # where the servo first sees it
SCENE_SEED, PLACES_SEED = 21, 3
NONE = (0.0, 0.0)
SECOND_DEPTH_MM = 4.0  # of a second sphere in front of or behind the first, largest
GLARES = 2


@dataclass(frozen=True)
class Case:
    """Rendering parameters for the pairs of one table row.

    `reach_mm` per axis around the tool centre point; `tilt` of the post against the tool axis, largest
    slope; `rim_lost` smallest and largest share of the rim hidden by an occluder, separately for each
    camera. Deceptive objects also have a smallest and a largest size, and are omitted at 0: two glares per
    camera by their radius, one blot of blood by half its angle, a second sphere by its distance
    perpendicular to the tool axis.
    """

    name: str
    reach_mm: float = CENTRED_MM
    tilt: float = 0.5
    deeper_mm: float = 0.0
    rim_lost: tuple[float, float] = NONE
    stained: float = 0.0
    glare_px: tuple[float, float] = NONE
    blot_rad: tuple[float, float] = NONE
    second_mm: tuple[float, float] = NONE
    area_px: tuple[int, int] = (800, 800)


@dataclass(frozen=True)
class View:
    """One camera's image of a sphere. `true_centre_px` and `offset_px` are full-sensor coordinates."""

    picture: Picture
    offset_px: tuple[int, int]
    true_centre_px: Array  # of the outline's ellipse
    radius_px: float
    rim_lost: float


@dataclass(frozen=True)
class Pair:
    """A sphere seen by both cameras, with its true position in the tool frame."""

    left: View
    right: View
    centre_mm: Array
    second_mm: Array | None = None

    @property
    def views(self) -> tuple[View, View]:
        return self.left, self.right


@dataclass(frozen=True)
class Studio:
    scene: Scene = field(default_factory=lambda: draw_scene("default", seed=SCENE_SEED))

    def pairs(self, case: Case, count: int, seed: int = PLACES_SEED) -> Iterator[Pair]:
        """Yield the pairs of a case one at a time to limit memory use."""
        generator = np.random.default_rng(seed)
        cameras = (self.scene.left, self.scene.right)
        optics = [LensOptics(camera, self.scene.seed) for camera in cameras]
        for number in range(count):
            place = generator.uniform(-case.reach_mm, case.reach_mm, 3) + np.array([0.0, 0.0, case.deeper_mm])
            post = np.array([*generator.uniform(-case.tilt, case.tilt, 2), -1.0])
            stains = self._draw_stains(case, number, generator)
            second = _draw_second_centre(case, place, generator)
            views = []
            for camera, optic in zip(cameras, optics, strict=True):
                lost, direction = generator.uniform(*case.rim_lost), generator.uniform(0.0, 2.0 * np.pi)
                disturbance = PictureDisturbance(
                    stains=((number % FILMS, stains),) if stains else (),
                    occluders=(Occluder(lost, direction),) if lost else (),
                    glares=_draw_glares(case, camera, generator),
                )
                spheres = [_sphere_in_camera(camera, place, post, number % FILMS)]
                if second is not None:
                    spheres.append(_sphere_in_camera(camera, second, post, FILMS))
                views.append(self._draw_view(camera, optic, spheres, disturbance, case, number))
            yield Pair(views[0], views[1], place, second)

    def calibration(self) -> StereoHeadCalibration:
        now = datetime.now(UTC)
        identity = PoseRecord(translation_mm=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
        left, right = (
            CameraCalibration(
                serial=camera.serial,
                focal_px=camera.focal_px,
                principal_point_px=camera.principal_point_px,
                distortion=camera.distortion,
                sensor_px=camera.sensor_px,
                camera_from_tool=camera.camera_from_tool,
            )
            for camera in (self.scene.left, self.scene.right)
        )
        return StereoHeadCalibration(
            identifier="truth",
            created=now,
            expires=now + timedelta(days=1),
            made_by="the scene",
            stated_error_mm=FINEST_MM,
            flange_from_tool=identity,
            left=left,
            right=right,
        )

    def _draw_stains(self, case: Case, number: int, generator: np.random.Generator) -> tuple[Stain, ...]:
        stains = draw_stains(number, number % FILMS, case.stained) if case.stained else ()
        if case.blot_rad == NONE:
            return stains
        x, y, z = generator.standard_normal(3)
        length = float(np.sqrt(x * x + y * y + z * z))
        # the sphere's z axis runs along the post towards the cameras: that half is visible
        towards = (float(x) / length, float(y) / length, abs(float(z)) / length)
        return (*stains, Stain(towards, float(generator.uniform(*case.blot_rad))))

    def _draw_view(
        self,
        camera: CameraTruth,
        optics: LensOptics,
        spheres: list[DrawnSphere],
        disturbance: PictureDisturbance,
        case: Case,
        number: int,
    ) -> View:
        area = _area_around(optics.lens, spheres[0], case.area_px, camera.sensor_px)
        pixels = Sensor(camera.read_noise_electrons, camera.full_well_electrons).read(
            optics.light_on(area, spheres, disturbance),
            exposure_us=EXPOSURE_US,
            gain_raw=GAIN_RAW,
            black_level_raw=BLACK_LEVEL_RAW,
            bits=8,
            noise=noise(self.scene.seed, f"camera {camera.serial}", number),
        )
        centre, radius = true_outline(optics.lens, spheres[0])
        lost = disturbance.occluders[0].rim_share if disturbance.occluders else 0.0
        return View(np.asarray(pixels, dtype=np.uint8), (area.x, area.y), centre, radius, lost)


def true_outline(lens: Lens, sphere: DrawnSphere) -> tuple[Array, float]:
    """Return the centre and mean radius (px) of the ellipse fitted to the projected outline."""
    outline = lens.project(sphere.outline_mm())
    middle = outline.mean(axis=0)
    x, y = (outline - middle).T
    conic = np.column_stack([x * x, x * y, y * y, x, y])
    a, b, c, d, e = np.linalg.lstsq(conic, np.ones(len(x)), rcond=None)[0]
    centre = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
    return middle + centre, float(np.hypot(x - centre[0], y - centre[1]).mean())


def _draw_second_centre(case: Case, place_mm: Array, generator: np.random.Generator) -> Array | None:
    if case.second_mm == NONE:
        return None
    away, direction = generator.uniform(*case.second_mm), generator.uniform(0.0, 2.0 * np.pi)
    deeper = generator.uniform(-SECOND_DEPTH_MM, SECOND_DEPTH_MM)
    return np.asarray(place_mm + np.array([away * np.cos(direction), away * np.sin(direction), deeper]))


def _draw_glares(case: Case, camera: CameraTruth, generator: np.random.Generator) -> tuple[Glare, ...]:
    if case.glare_px == NONE:
        return ()
    columns, rows = camera.sensor_px
    return tuple(
        Glare(
            (float(generator.uniform(0, columns)), float(generator.uniform(0, rows))),
            float(generator.uniform(*case.glare_px)),
        )
        for _ in range(GLARES)
    )


def _sphere_in_camera(camera: CameraTruth, place_mm: Array, post: Array, number: int) -> DrawnSphere:
    pose = matrix_of(camera.camera_from_tool)
    rotation = pose[:3, :3] @ rotation_towards(tuple(post), (1.0, 0.0, 0.0))
    return DrawnSphere(pose[:3, :3] @ place_mm + pose[:3, 3], RADIUS_MM, rotation, number)


def _area_around(
    lens: Lens, sphere: DrawnSphere, size_px: tuple[int, int], sensor_px: tuple[int, int]
) -> Area:
    """Return an area of the given size around a sphere's image, shifted to fit on the sensor."""
    middle = lens.project(sphere.centre_mm[None])[0]
    x, y = (
        int(np.clip(round(at - size / 2), 0, whole - size))
        for at, size, whole in zip(middle, size_px, sensor_px, strict=True)
    )
    return Area(x, y, *size_px)
