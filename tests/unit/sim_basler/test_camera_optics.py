"""Rendered spheres against the analytic projection, derived here from the conic, not from the renderer."""

from __future__ import annotations

import time

import numpy as np
import pytest
from camera_views import FOCAL_PX, FULL, PRINCIPAL_PX, RADIUS_MM, STRAIGHT, ball, bare_camera
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from scipy.special import ndtr

from ronna_hw.arrays import Array
from sim.basler.optics.canvas import Area, Lens, blur
from sim.basler.optics.film import CONTRAST, Film, Grain
from sim.basler.optics.picture import LensOptics
from sim.basler.optics.sensor import Lighting
from sim.basler.optics.sphere import DrawnSphere, draw_sphere
from sim.world.noise import noise
from sim.world.rigid import rotation_from_vector
from sim.world.scene.named_scenes import draw_scene

PLAIN_FILM = Film(Grain(0, 1), RADIUS_MM)


def lens(distortion: tuple[float, float, float, float, float] = STRAIGHT) -> Lens:
    return Lens((FOCAL_PX, FOCAL_PX), PRINCIPAL_PX, distortion, 250.0)


def expected_ellipse(centre_mm: tuple[float, float, float]) -> tuple[Array, Array]:
    """Centre and semi-axes (major first) in pixels of a sphere's outline without distortion.

    A ray u touches the sphere when (u.c)^2 = (c.c - r^2) u.u, a conic in the image plane.
    """
    c = np.array(centre_mm)
    conic = np.outer(c, c) - (c @ c - RADIUS_MM**2) * np.eye(3)
    quadratic, linear, constant = conic[:2, :2], conic[:2, 2], conic[2, 2]
    centre = -np.linalg.solve(quadratic, linear)
    level = -(constant + linear @ centre)
    axes = np.sqrt(level / np.linalg.eigvalsh(quadratic))
    return centre * FOCAL_PX + PRINCIPAL_PX, np.sort(axes)[::-1] * FOCAL_PX


def moments(cover: NDArray[np.float32]) -> tuple[Array, Array]:
    """Centre (x, y) and semi-axes of a filled ellipse from its moments."""
    rows, columns = np.indices(cover.shape)
    weight = cover.astype(float)
    total = weight.sum()
    centre = np.array([(weight * columns).sum(), (weight * rows).sum()]) / total
    x, y = columns - centre[0], rows - centre[1]
    spread = np.array(
        [[(weight * x * x).sum(), (weight * x * y).sum()], [(weight * x * y).sum(), (weight * y * y).sum()]]
    )
    # each pixel of a filled area has a variance of its own, 1/12
    spread = spread / total - np.eye(2) / 12
    return centre, 2 * np.sqrt(np.sort(np.linalg.eigvalsh(spread))[::-1])


PLACES = [(0.0, 0.0, 250.0), (3.0, -2.0, 251.0), (10.0, 4.0, 246.0), (-12.0, -4.5, 262.0)]


@pytest.mark.parametrize("place", PLACES)
def test_the_covered_area_is_the_ellipse_predicted_by_projection(place: tuple[float, float, float]) -> None:
    image = draw_sphere(ball(place), lens(), FULL, PLAIN_FILM)
    centre, axes = moments(image.cover)
    wanted_centre, wanted_axes = expected_ellipse(place)
    assert np.abs(centre - wanted_centre).max() < 0.002
    assert np.abs(axes - wanted_axes).max() < 0.002


@pytest.mark.parametrize("place", PLACES[1:])
def test_the_ellipse_centre_lies_outside_the_projected_centre_by_the_known_bias(
    place: tuple[float, float, float],
) -> None:
    image = draw_sphere(ball(place), lens(), FULL, PLAIN_FILM)
    centre, _ = moments(image.cover)
    c = np.array(place)
    off_axis = np.arctan2(np.hypot(c[0], c[1]), c[2])
    sin2_a = RADIUS_MM**2 / (c @ c)
    shift = np.sin(off_axis) * np.cos(off_axis) / (np.cos(off_axis) ** 2 - sin2_a) - np.tan(off_axis)
    outwards = c[:2] / np.hypot(c[0], c[1])
    found = (centre - (c[:2] / c[2] * FOCAL_PX + PRINCIPAL_PX)) @ outwards
    assert shift * FOCAL_PX > 0.07
    assert found == pytest.approx(shift * FOCAL_PX, abs=0.002)


def test_a_distorting_lens_moves_the_outline_as_computed() -> None:
    k1, k2, p1, p2, k3 = distortion = (0.06, -0.4, 2e-4, -1e-4, 0.1)
    place = (10.0, 3.0, 248.0)
    image = draw_sphere(ball(place), lens(distortion), FULL, PLAIN_FILM)
    c = np.array(place)
    share = 1 - RADIUS_MM**2 / (c @ c)
    first = np.cross(c, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(c, first) / np.linalg.norm(c)
    angle = np.linspace(0, 2 * np.pi, 720)[:, None]
    rim = share * c + RADIUS_MM * share**0.5 * (np.cos(angle) * first + np.sin(angle) * second)
    x, y = rim[:, 0] / rim[:, 2], rim[:, 1] / rim[:, 2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    seen = np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
            y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
        ]
    )
    outline = seen * FOCAL_PX + PRINCIPAL_PX
    # Area and centroid of the polygon against those of the covered pixels.
    a, b = outline[:-1], outline[1:]
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    centroid = ((a + b) * cross[:, None]).sum(axis=0) / (3 * cross.sum())
    centre, _ = moments(image.cover)
    straight = np.column_stack([x, y]).mean(axis=0) * FOCAL_PX + PRINCIPAL_PX
    assert np.linalg.norm(centroid - straight) > 0.4  # the distortion is seen at all
    assert np.abs(centre - centroid).max() < 0.003
    assert image.cover.sum() == pytest.approx(abs(cross.sum()) / 2, rel=2e-5)


def rim_points(light: Array, start: Array, radius_px: float) -> Array:
    """Points on the rim: along each ray the place of the middle between what is inside and outside."""
    found = []
    steps = np.arange(-12.0, 12.0, 0.05)
    for angle in np.linspace(0, 2 * np.pi, 360, endpoint=False):
        direction = np.array([np.cos(angle), np.sin(angle)])
        x, y = (start + (radius_px + steps)[:, None] * direction).T
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = x - column, y - row
        profile = (
            light[row, column] * (1 - fx) * (1 - fy)
            + light[row, column + 1] * fx * (1 - fy)
            + light[row + 1, column] * (1 - fx) * fy
            + light[row + 1, column + 1] * fx * fy
        )
        # The brightness inside is extrapolated to the rim, so that limb darkening does not pull it in.
        middle = (profile[-60:].mean() + np.polyval(np.polyfit(steps[:140], profile[:140], 1), 0.0)) / 2
        crossing = int(np.argmax(profile < middle))
        found.append(start + (radius_px + steps[crossing] - 0.025) * direction)
    return np.array(found)


def fitted_centre(points: Array) -> Array:
    """Centre of the algebraic ellipse through points."""
    mean, scale = points.mean(axis=0), points.std()
    x, y = ((points - mean) / scale).T
    design = np.column_stack([x * x, x * y, y * y, x, y])
    a, b, c, d, e = np.linalg.lstsq(design, np.ones(len(x)), rcond=None)[0]
    centre: Array = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
    return centre * scale + mean


@pytest.mark.parametrize("place", [(0.0, 0.0, 250.0), (6.0, 2.5, 250.0), (2.0, -1.0, 256.0)])
def test_the_light_on_the_sensor_has_its_rim_at_the_projected_outline(
    place: tuple[float, float, float],
) -> None:
    light = LensOptics(bare_camera(), 0).light_on(FULL, [ball(place)]).astype(float)
    wanted, axes = expected_ellipse(place)
    found = fitted_centre(rim_points(light, wanted, float(axes.mean())))
    assert np.abs(found - wanted).max() < 0.02


def thin_lens_sigma_px(depth_mm: float) -> float:
    """Blur of a lens of 50 mm at f/8, focused at 250 mm: diffraction, and a disc of D / 4 rms per axis."""
    focal_mm, pitch_mm = 50.0, 0.0055
    focused_mm, image_mm = (1.0 / (1.0 / focal_mm - 1.0 / distance) for distance in (250.0, depth_mm))
    disc_mm = focal_mm / 8.0 * abs(focused_mm - image_mm) / image_mm
    airy_sigma_mm = 0.42 * 850e-6 * 8.0 * (1.0 + focused_mm / 250.0)
    return float(np.hypot(disc_mm / 4.0, airy_sigma_mm) / pitch_mm)


@pytest.mark.parametrize("depth_mm", [250.0, 244.0, 256.0, 264.0])
def test_the_rim_is_as_soft_as_a_thin_lens_makes_it_at_its_depth(depth_mm: float) -> None:
    # across the post's axis nothing but film and background meets at the rim
    light = LensOptics(bare_camera(), 0).light_on(FULL, [ball((0.0, 0.0, depth_mm))]).astype(float)
    centre, axes = expected_ellipse((0.0, 0.0, depth_mm))
    rows = np.arange(round(centre[1]) - 20, round(centre[1]) + 21)[:, None]
    rims = centre[0] + np.sqrt(axes[0] ** 2 - (rows - centre[1]) ** 2)
    columns = np.round(rims).astype(int) + np.arange(-35, 36)
    beyond, seen = (columns - rims).ravel(), light[rows, columns].ravel()

    def soft_edge(x: Array, place: float, width: float, film: float, slope: float, ground: float) -> Array:
        return ground + (film + slope * x - ground) * ndtr((place - x) / width)

    found, _ = curve_fit(soft_edge, beyond, seen, p0=(0.0, 1.0, 1.5, 0.0, 0.05))
    assert found[0] == pytest.approx(0.0, abs=0.05)
    # the width of a pixel adds a twelfth of its square
    assert found[1] == pytest.approx(np.hypot(thin_lens_sigma_px(depth_mm), 12**-0.5), rel=0.06)


def test_the_light_is_uneven_differently_for_each_camera_and_darker_in_the_corners() -> None:
    scene = draw_scene("default", seed=3)
    left, right = (Lighting(3, camera.serial, (2048, 1088)) for camera in (scene.left, scene.right))
    for light in (left, right):
        on_film = light.on_film(FULL)
        assert on_film[543:545, 1023:1025].mean() == pytest.approx(2.0, rel=1e-3)
        opposite = (on_film + on_film[::-1, ::-1]) / 2.0  # without the slope
        assert opposite[0, 0] / 2.0 == pytest.approx(1.0 - 0.06 * (1.0 + (544 / 1024) ** 2), abs=1e-3)
        slope = abs(on_film[544, -1] - on_film[544, 0]) / 2.0 / 2.0
        assert 0.0 < slope <= 0.05
    assert np.abs(left.on_film(FULL) - right.on_film(FULL)).max() > 0.01


def test_the_brightness_of_a_sphere_follows_the_light_at_its_place() -> None:
    camera = bare_camera()
    optics, lighting = LensOptics(camera, 3), Lighting(3, camera.serial, camera.sensor_px)
    seen, falling = [], []
    for x_mm in (-15.0, 15.0):
        centre, _ = expected_ellipse((x_mm, 0.0, 250.0))
        middle = tuple(
            slice(round(brightness_at) - 60, round(brightness_at) + 60) for brightness_at in centre[::-1]
        )
        seen.append(optics.light_on(FULL, [ball((x_mm, 0.0, 250.0))])[middle].mean())
        falling.append(lighting.on_film(FULL)[middle].mean())
    assert abs(falling[0] / falling[1] - 1.0) > 0.005
    assert seen[0] / seen[1] == pytest.approx(falling[0] / falling[1], abs=0.005)


def test_the_limb_is_a_quarter_darker_than_the_middle() -> None:
    image = draw_sphere(ball((0.0, 0.0, 250.0)), lens(), FULL, PLAIN_FILM)
    full = image.light[image.cover > 0.999]
    rows, columns = np.indices(image.cover.shape)
    distance = np.hypot(columns - PRINCIPAL_PX[0], rows - PRINCIPAL_PX[1])
    middle = image.light[distance < 50].mean()
    limb = image.light[(distance > 255) & (distance < 260)].mean()
    assert full.min() > 0.5
    assert limb / middle == pytest.approx(0.75, abs=0.03)


def test_the_grain_is_fixed_to_the_sphere() -> None:
    points = noise(0, "points", 0).normal(size=(3, 20000)).astype(np.float32)
    points *= np.float32(RADIUS_MM) / np.linalg.norm(points, axis=0)
    grain = Grain(3, 2)
    values = grain.brightness_at(*points)
    assert values.std() == pytest.approx(CONTRAST, rel=0.1)
    assert values.mean() == pytest.approx(1.0, abs=0.002)
    assert np.array_equal(values, Grain(3, 2).brightness_at(*points))
    assert abs(np.corrcoef(values, Grain(3, 1).brightness_at(*points))[0, 1]) < 0.05
    # A sphere that turns shows other beads in the same place of the image, and the same beads elsewhere.
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    still = draw_sphere(ball((0, 0, 250.0), np.eye(3)), lens(), FULL, Film(grain, RADIUS_MM)).light
    moved = draw_sphere(ball((0, 0, 250.0), turned), lens(), FULL, Film(grain, RADIUS_MM)).light
    middle = (slice(440, 641), slice(920, 1121))  # square, around the principal point
    assert abs(np.corrcoef(still[middle].ravel(), moved[middle].ravel())[0, 1]) < 0.3
    back = np.corrcoef(still[middle].ravel(), np.rot90(moved[middle], 1).ravel())[0, 1]
    assert back > 0.9


def oblique(degrees: float) -> Array:
    """A sphere whose post leans so far from the direction to the camera."""
    angle = np.radians(degrees)
    post = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    across = np.array([0.0, 1.0, 0.0])
    return np.column_stack([across, np.cross(post, across), post])


def test_the_flange_cuts_the_rim_only_when_seen_from_the_side() -> None:
    light = {}
    for degrees in (0.0, 85.0):
        light[degrees] = LensOptics(bare_camera(), 0).light_on(FULL, [ball((0, 0, 250.0), oblique(degrees))])
    centre, axes = expected_ellipse((0.0, 0.0, 250.0))
    just_inside = (round(centre[1]), round(centre[0] - axes[0]) + 8)  # the side of the skull
    assert light[0.0][just_inside] > 1.2
    assert light[85.0][just_inside] < 0.5
    opposite = (round(centre[1]), round(centre[0] + axes[0]) - 8)
    assert light[85.0][opposite] > 1.2
    # the post is grey: darker than the film, brighter than the background
    on_post = light[85.0][round(centre[1]), round(centre[0] - axes[0]) - 180]
    assert 0.1 < on_post < 0.5


def test_the_nearer_of_two_spheres_hides_the_farther_one() -> None:
    near, far = ball((0.0, 0.0, 240.0)), ball((1.0, 0.0, 280.0))
    optics = LensOptics(bare_camera(), 0)
    both = optics.light_on(FULL, [near, far])
    alone = optics.light_on(FULL, [near])
    centre, axes = expected_ellipse((0.0, 0.0, 240.0))
    rows, columns = np.indices(both.shape)
    inside = np.hypot(columns - centre[0], rows - centre[1]) < axes[1] - 20
    assert np.allclose(both[inside], alone[inside], atol=1e-5)


def test_an_area_of_interest_shows_its_part_of_the_full_image() -> None:
    optics = LensOptics(bare_camera(), 0)
    full = optics.light_on(FULL, [ball((4.0, 1.0, 253.0))])
    area = Area(800, 200, 640, 480)
    part = optics.light_on(area, [ball((4.0, 1.0, 253.0))])
    same = np.isclose(part, full[200:680, 800:1440], atol=1e-4)
    assert same.mean() > 0.99  # a rounded position may fall into the neighbouring bead


@pytest.mark.parametrize("sigma", [0.65, 1.7, 4.0, 11.0])
def test_blur_has_its_width_and_preserves_the_light(sigma: float) -> None:
    patch = np.zeros((161, 161), np.float32)
    patch[80, 80] = 1.0
    spread = blur(patch, sigma)
    rows, columns = np.indices(patch.shape) - 80
    assert spread.sum() == pytest.approx(1.0, abs=1e-3)
    assert np.sqrt((spread * rows**2).sum()) == pytest.approx(sigma, rel=0.05)
    assert np.sqrt((spread * columns**2).sum()) == pytest.approx(sigma, rel=0.05)


def test_a_sphere_behind_or_inside_the_lens_is_not_drawn() -> None:
    optics = LensOptics(bare_camera(), 0)
    dark = optics.light_on(FULL, [])
    assert np.allclose(optics.light_on(FULL, [ball((0, 0, -250.0)), ball((0, 0, 20.0))]), dark)
    assert dark.max() < 0.1


def test_a_servo_image_renders_within_its_time_budget() -> None:
    optics = LensOptics(bare_camera(), 0)
    area = Area(512, 32, 1024, 1024)
    optics.light_on(area, [ball((0.0, 0.0, 250.0))])
    costs = []
    for _ in range(5):
        begun = time.thread_time()
        optics.light_on(area, [ball((0.0, 0.0, 250.0))])
        costs.append(time.thread_time() - begun)
    assert min(costs) < 0.040


def test_any_sphere_in_any_area_gives_finite_non_negative_light() -> None:
    optics = LensOptics(bare_camera(), 0)
    chance = noise(1, "spheres and areas", 0)
    for _ in range(60):
        spheres = []
        for number in range(int(chance.integers(0, 4))):
            place = (*chance.normal(0.0, (30.0, 20.0)), chance.choice((chance.uniform(40, 1000), 250.0)))
            spheres.append(
                DrawnSphere(np.array(place), RADIUS_MM, rotation_from_vector(chance.normal(0, 2, 3)), number)
            )
        width, height = int(chance.choice((16, 640, 2048))), int(chance.choice((1, 480, 1088)))
        area = Area(
            int(chance.integers(0, 2049 - width)), int(chance.integers(0, 1089 - height)), width, height
        )
        light = optics.light_on(area, spheres)
        assert light.shape == (height, width)
        assert np.isfinite(light).all()
        assert light.min() >= 0.0
