"""From light to bytes: noise, saturation, formats, and the same picture for the same trigger."""

from __future__ import annotations

import numpy as np
import psutil
import pytest
from camera_views import aim_at_first_sphere
from numpy.typing import NDArray

from ronna_hw.wire.gige_vision import PixelFormat
from sim.basler.camera.photographer import Photographer, PhotographerApart, to_wire
from sim.basler.camera.photographer import ramp_image as ramp
from sim.basler.camera.view import View
from sim.basler.optics.canvas import Area
from sim.basler.optics.sensor import Sensor
from sim.basler.settings import CameraSettings, FrameSettings, RampImage
from sim.world.noise import noise
from sim.world.rigid import apply, matrix_of, rotation_towards
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

READ_NOISE, FULL_WELL = 13.5, 11900.0
AREA = Area(512, 32, 1024, 1024)


def frame(**changes: object) -> FrameSettings:
    settings = CameraSettings(width=AREA.width, height=AREA.height, offset_x=AREA.x, offset_y=AREA.y)
    for name, value in changes.items():
        setattr(settings, name, value)
    return settings.frame()


def read(electrons: float, *, bits: int = 12, gain_raw: int = 32, seed: int = 0) -> NDArray[np.float64]:
    light = np.full((500, 500), electrons / 1000.0, np.float32)
    sensor = Sensor(READ_NOISE, FULL_WELL)
    pixels = sensor.read(
        light,
        exposure_us=1000,
        gain_raw=gain_raw,
        black_level_raw=64,
        bits=bits,
        noise=noise(seed, "sensor", 0),
    )
    return pixels.astype(float)


@pytest.mark.parametrize("electrons", [50.0, 500.0, 5000.0])
def test_noise_is_shot_noise_and_read_noise(electrons: float) -> None:
    electrons_per_step = FULL_WELL / 4095
    values = read(electrons) - 64 * 4
    assert values.mean() * electrons_per_step == pytest.approx(electrons, abs=1.0)
    # quantisation adds a twelfth of a squared step
    expected = (electrons + READ_NOISE**2) / electrons_per_step**2 + 1 / 12
    assert values.var() == pytest.approx(expected, rel=0.02)


def test_noise_of_neighbouring_pixels_is_independent() -> None:
    values = read(1000.0) - read(1000.0).mean()
    for shifted in (values[:, 1:] * values[:, :-1], values[1:] * values[:-1]):
        assert abs(shifted.mean()) / values.var() < 0.01


def test_the_sensor_saturates_at_full_scale() -> None:
    assert read(50_000.0).min() == 4095
    assert read(50_000.0, bits=8).min() == 255
    assert read(7000.0, bits=8, gain_raw=64).min() == 255


def test_gain_multiplies_the_signal_but_not_the_black_level() -> None:
    single, double = read(800.0) - 256, read(800.0, gain_raw=64) - 256
    assert double.mean() == pytest.approx(2 * single.mean(), rel=0.01)


def test_eight_bit_pixels_are_twelve_bit_pixels_without_the_last_four_bits() -> None:
    assert read(3000.0, bits=8).mean() == pytest.approx(read(3000.0).mean() / 4095 * 255, abs=0.6)


def test_packed_pixels_hold_two_pixels_in_three_bytes() -> None:
    pixels = np.array([[0xABC, 0x123, 0xFFF, 0x000]], np.uint16)
    assert to_wire(pixels, PixelFormat.MONO12_PACKED).hex() == "ab3c12" + "ff0f00"
    assert to_wire(pixels, PixelFormat.MONO12).hex() == "bc0a2301ff0f0000"


def test_test_images_are_ramps() -> None:
    fixed = frame(test_image=RampImage.FIXED)
    assert np.array_equal(ramp(fixed, 1), ramp(fixed, 2))
    assert ramp(fixed, 1)[3, 5] == (AREA.x + AREA.y + 8) % 256
    moving = frame(test_image=RampImage.MOVING, pixel_format=PixelFormat.MONO12)
    assert ramp(moving, 2)[0, 0] == ramp(moving, 1)[0, 0] + 1


def test_the_same_trigger_number_gives_the_same_bytes() -> None:
    world = World.create(draw_scene("bench"), paced=False)
    camera = Photographer(world, world.scene.left)
    again = Photographer(world, world.scene.left)
    first = camera.triggered(frame(), 7)
    assert camera.triggered(frame(), 8) != first
    assert again.triggered(frame(), 7) == first
    assert Photographer(world, world.scene.right).triggered(frame(), 7) != first


@pytest.mark.parametrize("ending", ["kill", "suspend"])
def test_a_process_of_its_own_takes_the_same_image_and_is_replaced_once_lost(ending: str) -> None:
    world = World.create(draw_scene("bench"), paced=False)
    expected = Photographer(world, world.scene.right).triggered(frame(), 7)
    others = psutil.Process().children()  # left by earlier tests of this worker
    apart = PhotographerApart(world, world.scene.right)
    try:
        assert apart.triggered(frame(), 7) == expected
        (process,) = (child for child in psutil.Process().children() if child not in others)
        getattr(process, ending)()
        assert apart.triggered(frame(), 7) == expected
    finally:
        apart.close()
    assert not process.is_running()


def brightest(image: bytes) -> int:
    return int(np.percentile(np.frombuffer(image, np.uint8), 99))


def test_the_bench_shows_a_sphere_to_both_cameras() -> None:
    world = World.create(draw_scene("bench"), paced=False)
    for truth in (world.scene.left, world.scene.right):
        pixels = np.frombuffer(Photographer(world, truth).triggered(frame(), 1), np.uint8).reshape(1024, 1024)
        assert 180 < pixels[400:600, 400:600].mean() < 230
        assert pixels[:100, :100].mean() < 20


def test_nothing_is_in_view_without_an_arm() -> None:
    world = World.create(draw_scene("default"), paced=False)
    assert brightest(Photographer(world, world.scene.left).triggered(frame(), 1)) < 30


def test_a_sphere_near_the_tool_centre_point_has_its_computed_place_in_both_cameras() -> None:
    world = World.create(draw_scene("default", seed=4), paced=False)
    for offset in ((0.0, 0.0, 0.0), (4.0, -3.0, 2.0)):
        aim_at_first_sphere(world, offset)
        for truth in (world.scene.left, world.scene.right):
            view = View(world, truth)
            spheres = {sphere.number: sphere for sphere in view.spheres(view.pose())}
            tool_from_centre = rotation_towards((0, 0, -1), (1, 0, 0)).T @ -np.array(offset)
            expected = apply(matrix_of(truth.camera_from_tool), tool_from_centre)
            assert np.allclose(spheres[1].centre_mm, expected, atol=1e-9)
            assert np.allclose(
                spheres[1].camera_from_sphere.T @ spheres[1].camera_from_sphere, np.eye(3), atol=1e-12
            )


def test_a_camera_sees_nothing_while_the_guide_is_mounted() -> None:
    world = World.create(draw_scene("default"), paced=False)
    aim_at_first_sphere(world)
    camera = Photographer(world, world.scene.left)
    assert brightest(camera.triggered(frame(), 1)) > 150
    world.mount_tool(world.scene.mount.tool_number_guide)
    assert brightest(camera.triggered(frame(), 2)) < 30


def test_a_free_running_camera_repeats_prepared_pictures_until_the_view_changes() -> None:
    world = World.create(draw_scene("default"), paced=False)
    aim_at_first_sphere(world)
    camera = Photographer(world, world.scene.left)
    first = camera.running(frame(), 0)[1]
    assert brightest(first) > 150
    assert camera.running(frame(), 0)[1] is first
    world.mount_tool(world.scene.mount.tool_number_guide)
    for number in range(10_000):
        if brightest(camera.running(frame(), number)[1]) < 30:
            return
    pytest.fail("the pictures were never renewed")


def test_a_prepared_picture_carries_the_settings_it_was_taken_with() -> None:
    world = World.create(draw_scene("bench"), paced=False)
    camera = Photographer(world, world.scene.left)
    small = frame(width=64, height=32)
    settings, image = camera.running(small, 0)
    assert len(image) == settings.payload_bytes == 64 * 32
    settings, image = camera.running(frame(width=64, height=32, pixel_format=PixelFormat.MONO12), 1)
    assert len(image) == settings.payload_bytes == 64 * 32 * 2


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_a_picture_is_rendered_wherever_the_head_is_over_a_sphere(seed: int) -> None:
    scene = draw_scene("default", seed=seed)
    world = World.create(scene, paced=False)
    photographer = Photographer(world, scene.left)
    generator = np.random.default_rng(seed)
    frame = CameraSettings().frame()
    for number in range(12):
        axis = generator.normal(0.0, 0.4, 3) - (0.0, 0.0, 1.0)
        aim_at_first_sphere(world, generator.normal(0.0, 12.0, 3), axis)
        image = photographer.triggered(frame, number)
        assert len(image) == frame.payload_bytes
