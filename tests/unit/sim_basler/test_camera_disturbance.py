"""Stains, occluders, glare and a camera turned in its mount, checked against independent geometry."""

from __future__ import annotations

import numpy as np
import pytest
from camera_views import FOCAL_PX, FULL, PRINCIPAL_PX, RADIUS_MM, aim_at_first_sphere, ball, bare_camera
from numpy.typing import NDArray

from ronna_hw.arrays import Array
from sim.basler.camera.photographer import Photographer
from sim.basler.camera.view import View, ViewDisturbances
from sim.basler.optics.canvas import Area
from sim.basler.optics.film import STAINED_BRIGHTNESS, Stain, draw_stains
from sim.basler.optics.picture import Glare, LensOptics, Occluder, PictureDisturbance
from sim.basler.optics.sensor import Sensor
from sim.basler.optics.sphere import DrawnSphere
from sim.basler.settings import CameraSettings, FrameSettings
from sim.errors import BadFaultScript
from sim.world.faults import check_faults, parse_faults
from sim.world.rigid import matrix_of
from sim.world.scene.model import CameraTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World


def light(disturbance: PictureDisturbance, spheres: list[DrawnSphere] | None = None) -> Array:
    drawn = LensOptics(bare_camera(), 0).light_on(FULL, [ball()] if spheres is None else spheres, disturbance)
    return drawn.astype(float)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.6])
def test_a_stain_has_its_projected_place_and_size(tilt_rad: float) -> None:
    half_angle = 0.12
    # the sphere's frame looks at the camera: its z axis is the camera's -z
    stain = Stain((float(np.sin(tilt_rad)), 0.0, float(np.cos(tilt_rad))), half_angle)
    lost = light(PictureDisturbance()) - light(PictureDisturbance(stains=((1, (stain,)),)))
    share = lost / np.maximum(light(PictureDisturbance()), 0.5) / (1.0 - STAINED_BRIGHTNESS)
    rows, columns = np.indices(share.shape)
    found = np.array([(share * columns).sum(), (share * rows).sum()]) / share.sum()
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)[:, None]
    axis, across = np.array([np.sin(tilt_rad), 0.0, -np.cos(tilt_rad)]), np.array([0.0, 1.0, 0.0])
    other = np.cross(axis, across)
    edge = np.cos(half_angle) * axis + np.sin(half_angle) * (np.cos(angle) * across + np.sin(angle) * other)
    points = np.array([0.0, 0.0, 250.0]) + RADIUS_MM * edge
    outline = points[:, :2] / points[:, 2:] * FOCAL_PX + PRINCIPAL_PX
    a, b = outline, np.roll(outline, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    assert found == pytest.approx(((a + b) * cross[:, None]).sum(axis=0) / (3 * cross.sum()), abs=0.1)
    assert share.sum() == pytest.approx(abs(cross.sum()) / 2, rel=0.02)


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_drawn_stains_cover_the_requested_share(share: float) -> None:
    areas = [(1.0 - np.cos(stain.half_angle_rad)) / 2.0 for stain in draw_stains(3, 2, share)]
    assert share <= sum(areas) < share + 0.006
    assert draw_stains(3, 2, share) == draw_stains(3, 2, share) != draw_stains(3, 1, share)


@pytest.mark.parametrize(("share", "direction"), [(0.1, 0.3), (0.3, 2.0), (0.45, -1.2)])
def test_an_occluder_hides_its_share_of_the_rim(share: float, direction: float) -> None:
    seen = light(PictureDisturbance(occluders=(Occluder(share, direction),)))
    angle = np.arange(3600) * (2 * np.pi / 3600)
    rim = FOCAL_PX * RADIUS_MM / np.sqrt(250.0**2 - RADIUS_MM**2)
    radius = rim - 4.0  # just inside, where the chord leaves a little less of the circle beyond it
    columns = np.rint(PRINCIPAL_PX[0] + radius * np.cos(angle)).astype(int)
    rows = np.rint(PRINCIPAL_PX[1] + radius * np.sin(angle)).astype(int)
    hidden = seen[rows, columns] < 0.5
    assert hidden.mean() == pytest.approx(np.arccos(rim * np.cos(np.pi * share) / radius) / np.pi, abs=0.005)
    middle = np.angle(np.exp(1j * angle[hidden]).sum())
    assert middle == pytest.approx(direction, abs=0.02)


def test_a_glare_saturates_its_own_place_and_nothing_else() -> None:
    glare = Glare((300.5, 200.0), 60.0)
    seen, clean = light(PictureDisturbance(glares=(glare,)), []), light(PictureDisturbance(), [])
    extra = seen - clean
    rows, columns = np.indices(extra.shape)
    centre = np.array([(extra * columns).sum(), (extra * rows).sum()]) / extra.sum()
    assert centre == pytest.approx([300.5, 200.0], abs=0.01)
    assert (extra > extra.max() / 2).sum() == pytest.approx(np.pi * 60.0**2, rel=0.01)
    pixels = Sensor(13.5, 11900.0).read(
        seen, exposure_us=2000.0, gain_raw=100, black_level_raw=32, bits=8, noise=None
    )
    assert pixels[200, 300] == 255
    assert pixels[200, 400] < 20


def test_a_disturbed_area_of_interest_shows_its_part_of_the_full_image() -> None:
    disturbance = PictureDisturbance(
        stains=((1, draw_stains(1, 1, 0.05)),),
        occluders=(Occluder(0.2, 1.0),),
        glares=(Glare((1200.0, 400.0), 90.0),),
    )
    optics = LensOptics(bare_camera(), 0)
    full = optics.light_on(FULL, [ball()], disturbance)
    part = optics.light_on(Area(800, 200, 640, 480), [ball()], disturbance)
    assert np.isclose(part, full[200:680, 800:1440], atol=1e-4).mean() > 0.99


def frame() -> FrameSettings:
    settings = CameraSettings()
    settings.offset_x, settings.width, settings.height = 512, 1024, 1024
    return settings.frame()


def picture(world: World, truth: CameraTruth, number: int) -> NDArray[np.int16]:
    image = Photographer(world, truth).triggered(frame(), number)
    return np.frombuffer(image, np.uint8).reshape(1024, 1024).astype(np.int16)


@pytest.mark.parametrize(
    ("line", "sides"),
    [
        ("camera stain marker 1 20 %", "left right"),
        ("camera occlude left 30 %", "left"),
        ("camera glare right 900 px", "right"),
        ("camera twist right -0.1 deg", "right"),
    ],
)
def test_a_fault_changes_the_pictures_of_its_cameras_only_while_it_is_active(line: str, sides: str) -> None:
    world = World.create(draw_scene("bench"), paced=False)
    cameras = {"left": world.scene.left, "right": world.scene.right}
    before = {side: picture(world, truth, 1) for side, truth in cameras.items()}
    world.set_fault_script(f"now: {line} for 1 s")
    changed = {
        side for side, truth in cameras.items() if np.abs(picture(world, truth, 1) - before[side]).max() > 60
    }
    assert changed == set(sides.split())
    world.clock.sleep(2.0)
    assert all(np.array_equal(picture(world, truth, 1), before[side]) for side, truth in cameras.items())


def test_a_twisted_camera_sees_everything_turned_about_its_centre() -> None:
    world = World.create(draw_scene("default", seed=4), paced=False)
    scene = world.scene
    aim_at_first_sphere(world)
    for truth in (scene.left, scene.right):
        view = View(world, truth)
        straight, twisted = (view.spheres(view.pose(), angle)[0].centre_mm for angle in (0.0, 1e-3))
        assert np.linalg.norm(twisted) == pytest.approx(np.linalg.norm(straight), abs=1e-9)
        moved_in_tool = matrix_of(truth.camera_from_tool)[:3, :3].T @ (twisted - straight)
        # 0.25 m away a thousandth of a radian is a quarter of a millimetre, in the plane y z of both cameras
        assert np.linalg.norm(moved_in_tool) == pytest.approx(0.25, rel=0.01)
        assert abs(moved_in_tool[0]) < 1e-6


def test_a_creeping_camera_keeps_turning_with_theatre_time() -> None:
    world = World.create(draw_scene("bench"), paced=False)
    left, right = (ViewDisturbances(world, truth) for truth in (world.scene.left, world.scene.right))
    world.set_fault_script("at 10 s: camera creep left -0.02 deg per min for 60 s")
    turned_deg = []
    for _ in range(4):  # at 0, 25, 50 and 75 s
        turned_deg.append(float(np.degrees(left.now().twist_rad)))
        assert right.now().twist_rad == 0.0
        world.clock.sleep(25.0)
    assert turned_deg == pytest.approx([0.0, -0.005, -0.04 / 3.0, 0.0])


@pytest.mark.parametrize(
    ("line", "mistake"),
    [
        ("camera glare middle 40 px", "expected camera left or right, got middle"),
        ("camera occlude left 130 %", "at most 100 %, got 130"),
        ("camera stain marker 9 5 %", "expected marker 1, .* got 9"),
        ("camera stain marker 1 95 %", "at most 60 %"),
        ("camera twist top 0.1 deg", "got top"),
    ],
)
def test_a_vision_fault_with_an_invalid_target_or_amount_is_refused(line: str, mistake: str) -> None:
    with pytest.raises(BadFaultScript, match=mistake):
        check_faults(parse_faults(f"now: {line}"), draw_scene("default"))
