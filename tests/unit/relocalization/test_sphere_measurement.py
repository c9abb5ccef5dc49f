"""measure_sphere on images with known truth, and on images without a sphere."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from bounded_cost import cpu_median_s
from coded_errors import raises
from scipy.ndimage import gaussian_filter

from procedures.relocalization import AreaImage, SphereStatus, locate_sphere, measure_sphere, measure_spheres
from procedures.relocalization.errors import (
    BAD_MEASUREMENT,
    BadImage,
    NoContrast,
    NoSphere,
    RaysDoNotMeet,
    Saturated,
)
from procedures.relocalization.sphere_measurement import radius_range_px
from ronna_hw.arguments import WrongArgument

FOCAL_PX = 62.5e3 / 5.5
RADIUS_MM = 5.75
NOMINAL = np.array([0.7, -0.4, 250.0])
MICROMETRES_PER_PX = 22.0


def ellipse_centre(centre_mm, size=(2048, 1088)):
    """Centre of a sphere's outline: the section of its tangent cone by the image plane."""
    x, y, z = centre_mm
    scale = FOCAL_PX * z / (z**2 - RADIUS_MM**2)
    return np.array([x * scale + (size[0] - 1) / 2, y * scale + (size[1] - 1) / 2])


def error_um(sphere, centre_mm, size=(2048, 1088)):
    return MICROMETRES_PER_PX * float(np.linalg.norm(sphere.centre_px - ellipse_centre(centre_mm, size)))


def test_a_clean_sphere_is_measured_to_one_micrometre(renderer, look):
    sphere = measure_sphere(renderer.sphere(NOMINAL, look()))
    assert sphere.status is SphereStatus.OK
    assert error_um(sphere, NOMINAL) < 1.0
    assert sphere.axes_px[0] >= sphere.axes_px[1] == pytest.approx(261.4, abs=0.2)
    assert 0.9 < sphere.quality <= 1.0
    assert sphere.rim_fraction > 0.97


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"post": True}, marks=pytest.mark.slow),
        {"post": True, "stains": 3},
        {"blur_px": 3.0},
        pytest.param({"unevenness": 0.4, "post": True}, marks=pytest.mark.slow),
        {"occluded_width": 0.2, "stains": 2},
        pytest.param({"bits": 12, "post": True}, marks=pytest.mark.slow),
        {"bright": 320.0},
    ],
    ids=["post", "stains", "defocus", "uneven light", "occluded", "12 bits", "saturated"],
)
def test_a_partly_hidden_or_blurred_rim_does_not_pull_the_centre(renderer, look, changes):
    sphere = measure_sphere(renderer.sphere(NOMINAL, look(**changes)))
    assert sphere.status is SphereStatus.OK
    assert error_um(sphere, NOMINAL) < 3.0


@pytest.mark.hazard(27)
@pytest.mark.parametrize("pictures", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_a_sphere_with_more_than_a_third_of_its_rim_hidden_is_unreliable(renderer, look, pictures):
    statuses = [
        measure_sphere(renderer.sphere(NOMINAL, look(occluded_width=0.36, stains=1))).status
        for _ in range(pictures)
    ]
    assert statuses == [SphereStatus.UNRELIABLE] * pictures


def test_the_visible_share_of_the_rim_is_measured(renderer, look):
    visible = measure_sphere(renderer.sphere(NOMINAL, look(occluded_width=0.2))).rim_fraction
    assert visible == pytest.approx(1.0 - np.arccos(1.0 - 0.4) / np.pi, abs=0.02)


def with_blood_up_to(picture, column):
    """Everything to the left of a column at a third of its brightness."""
    stained = picture.astype(float)
    stained[:, :column] = 12.0 + 0.3 * (stained[:, :column] - 12.0)
    return np.rint(np.clip(stained, 0, 255)).astype(np.uint8)


def test_a_rim_dimmed_by_a_stain_still_counts_as_visible(renderer, look):
    column = round(ellipse_centre(NOMINAL)[0]) - 100
    sphere = measure_sphere(with_blood_up_to(renderer.sphere(NOMINAL, look()), column))
    assert sphere.status is SphereStatus.OK
    assert sphere.rim_fraction > 0.95
    assert error_um(sphere, NOMINAL) < 3.0


@pytest.mark.hazard(27)
def test_an_outline_with_too_little_undimmed_rim_is_unreliable(renderer, look):
    picture = renderer.sphere(NOMINAL, look())
    u, v = ellipse_centre(NOMINAL)
    rows, columns = np.mgrid[:1088, :2048]
    crust = (np.hypot(columns - u, rows - v) > 240) & (columns < u - 20)
    stained = np.where(crust, with_blood_up_to(picture, 2048), picture)
    stained[: round(v) - 155] = 12  # hides 0.3 of the rim: 0.33 is below the crust, 0.37 is left
    assert measure_sphere(stained).status is SphereStatus.UNRELIABLE


def test_half_a_sphere_at_the_border_is_unreliable(renderer, look):
    sphere = measure_sphere(renderer.sphere(np.array([22.0, 0.0, 250.0]), look()))
    assert sphere.status is SphereStatus.UNRELIABLE
    assert sphere.rim_fraction < 0.62


@pytest.mark.hazard(27)
def test_a_glare_and_a_second_sphere_at_the_border_are_ignored(renderer, look):
    rows, columns = np.mgrid[:1088, :2048]
    scene = np.where(np.hypot(columns - 300, rows - 300) < 60, 255.0, 12.0)
    other = renderer.sphere(np.array([22.0, 3.0, 255.0]), look(), scene=gaussian_filter(scene, 1.0))
    sphere = measure_sphere(renderer.sphere(NOMINAL, look(post=True), scene=other))
    assert error_um(sphere, NOMINAL) < 2.0


def test_the_radius_range_chooses_between_two_discs(renderer, look):
    far = np.array([20.0, 0.0, 420.0])
    picture = renderer.sphere(NOMINAL, look(), scene=renderer.sphere(far, look()))
    assert measure_sphere(picture).axes_px[0] == pytest.approx(261.4, abs=1.0)
    assert measure_sphere(picture, radius_range_px=(140.0, 170.0)).axes_px[0] == pytest.approx(155.6, abs=1.0)


@pytest.mark.parametrize("bits", [8, pytest.param(12, marks=pytest.mark.slow)])
def test_equalized_contrast_finds_the_same_sphere_but_moves_its_centre(renderer, look, bits):
    picture = renderer.sphere(NOMINAL, look(blur_px=3.0, post=True, bits=bits))
    plain, equalized = measure_sphere(picture), measure_sphere(picture, enhance_contrast=True)
    assert equalized.status is SphereStatus.OK
    assert error_um(plain, NOMINAL) < error_um(equalized, NOMINAL) < MICROMETRES_PER_PX


@pytest.mark.parametrize("size", [(640, 640), (800, 576)])
def test_an_area_of_interest_is_as_good_as_the_full_frame(renderer, look, size):
    centre = np.array([0.1, 0.05, 250.0])
    sphere = measure_sphere(renderer.sphere(centre, look(post=True), size=size))
    assert error_um(sphere, centre, size) < 1.5


def test_any_strides_give_the_same_result_and_the_image_is_left_unchanged(renderer, look):
    picture = renderer.sphere(NOMINAL, look())
    before = picture.copy()
    picture.flags.writeable = False
    expected = measure_sphere(picture)
    spread = np.zeros((2176, 4096), np.uint8)
    spread[::2, ::2] = picture
    assert measure_sphere(spread[::2, ::2]) == expected
    assert measure_sphere(np.asfortranarray(picture)) == expected
    assert np.array_equal(picture, before)


def test_a_flipped_image_gives_the_flipped_centre(renderer, look):
    picture = renderer.sphere(NOMINAL, look(grain=0.0))
    x, y = measure_sphere(picture).centre_px
    flipped_x, flipped_y = measure_sphere(picture[::-1, ::-1]).centre_px
    assert (2047 - flipped_x, 1087 - flipped_y) == pytest.approx((x, y), abs=0.02)


@pytest.mark.slow
def test_the_scatter_of_the_centre_stays_within_twice_its_predicted_sigma(renderer, look):
    found = [measure_sphere(renderer.sphere(NOMINAL, look(bright=60.0), size=(800, 800))) for _ in range(12)]
    scatter = np.var([sphere.centre_px for sphere in found], axis=0).mean()
    predicted = np.mean([np.trace(np.array(sphere.covariance_px2)) / 2 for sphere in found])
    assert scatter < 4.0 * predicted
    assert predicted < 0.05**2


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((100, 100)),
        np.zeros((100, 100, 3), np.uint8),
        np.zeros((0, 0), np.uint8),
        np.zeros((30, 200), np.uint8),
        np.full((100, 100), 5000, np.uint16),
        [[1, 2], [3, 4]],
        None,
    ],
)
def test_an_input_that_is_not_a_grey_image_is_refused_in_one_line(image):
    with pytest.raises(BadImage) as caught:
        measure_sphere(image)
    assert caught.value.code == "STE-001"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("level", "kind", "error", "said"),
    [
        (0, np.uint8, NoContrast, "STE-002.*completely dark"),
        (120, np.uint8, NoContrast, "STE-002.*no contrast"),
        (255, np.uint8, Saturated, "STE-011: the image is saturated.*exposure"),
        (4095, np.uint16, Saturated, "STE-011: the image is saturated.*exposure"),
    ],
)
def test_a_uniform_image_is_told_as_dark_even_or_saturated(level, kind, error, said):
    with pytest.raises(error, match=said):
        measure_sphere(np.full((1088, 2048), level, kind))


@pytest.mark.hazard(27)
def test_shapes_other_than_spheres_are_refused():
    rows, columns = np.mgrid[:1088, :2048]
    distance = np.hypot(columns - 1000, rows - 500)
    square = (np.abs(columns - 1000) < 200) & (np.abs(rows - 500) < 200)
    long = ((columns - 1000) / 260) ** 2 + ((rows - 500) / 150) ** 2 < 1
    for shape in (square, long, np.abs(distance - 250) < 10, distance > 250):
        picture = gaussian_filter(np.where(shape, 180.0, 12.0), 1.0).astype(np.uint8)
        with pytest.raises(NoSphere, match="STE-003"):
            measure_sphere(picture)


def test_clutter_without_a_sphere_is_refused_and_a_sphere_in_clutter_is_found(renderer, look):
    rows, columns = np.mgrid[:1088, :2048]
    scene = np.full((1088, 2048), 12.0)
    for _ in range(120):
        x, y = renderer.random.uniform(0, 2048), renderer.random.uniform(0, 1088)
        around = np.s_[max(0, int(y) - 31) : int(y) + 32, max(0, int(x) - 31) : int(x) + 32]
        blob = np.hypot(columns[around] - x, rows[around] - y) < renderer.random.uniform(3, 30)
        scene[around][blob] = renderer.random.uniform(20, 200)
    with pytest.raises(NoSphere):
        measure_sphere(scene.astype(np.uint8), radius_range_px=(200.0, 330.0))
    assert error_um(measure_sphere(renderer.sphere(NOMINAL, look(), scene=scene)), NOMINAL) < 5.0


@pytest.mark.slow
def test_a_sphere_is_measured_in_half_the_time_of_a_filter_over_its_frame(renderer, look):
    """The budget in ms is the benchmark's; twice the usual share of 0.27 means that something broke."""
    picture = renderer.sphere(NOMINAL, look(post=True, stains=3))
    measuring, filtering = (
        cpu_median_s(partial(call, *arguments), 9)
        for call, arguments in ((measure_sphere, (picture,)), (gaussian_filter, (picture.astype(float), 1.0)))
    )
    assert measuring < 0.54 * filtering


def test_the_status_names_match_the_interface():
    assert [str(status) for status in SphereStatus] == ["OK", "UNRELIABLE"]


@pytest.mark.parametrize("order", ["<u2", ">u2", "=u2"])
def test_any_byte_order_gives_the_same_centre_and_is_left_unchanged(renderer, look, order):
    image = renderer.sphere(NOMINAL, look(bits=12)).astype(order)
    before = image.tobytes()
    image.flags.writeable = False
    assert measure_sphere(image) == measure_sphere(image.astype(np.uint16))
    assert image.dtype == np.dtype(order)
    assert image.tobytes() == before


PLACE_MM = np.array([1.0, -0.5, 0.3])


def pair(renderer, head, look, *, scenes=(None, None), point=PLACE_MM, looks=None):
    looks = looks or {"left": look(), "right": look()}
    return [
        AreaImage(renderer.sphere(head.in_camera(side, point), looks[side], scene=scene))
        for side, scene in zip(("left", "right"), scenes, strict=True)
    ]


def disc(x, y, radius, grey=255.0):
    """A glare: a bright disc where no sphere is."""
    rows, columns = np.mgrid[:1088, :2048]
    return gaussian_filter(np.where(np.hypot(columns - x, rows - y) < radius, grey, 12.0), 2.0)


def pair_error_um(sighting, point=PLACE_MM):
    return 1e3 * float(np.linalg.norm(sighting.point.position_mm - point))


def test_a_single_sphere_is_located(renderer, head, look):
    assert pair_error_um(locate_sphere(*pair(renderer, head, look), head.calibration)) < 2.0


def test_with_enhanced_contrast_both_outlines_of_a_sphere_scatter_more(renderer, head, look):
    images = pair(renderer, head, look)
    plain, enhanced = (
        locate_sphere(*images, head.calibration, enhance_contrast=enhance) for enhance in (False, True)
    )
    assert enhanced.point is not None
    for before, after in ((plain.left, enhanced.left), (plain.right, enhanced.right)):
        assert after.scatter_px > 1.5 * before.scatter_px


@pytest.mark.hazard(27)
def test_a_glare_as_large_as_the_sphere_in_one_image_is_not_taken_for_it(renderer, head, look):
    left, right = pair(
        renderer,
        head,
        look,
        scenes=(disc(350, 500, 280), None),
        looks={"left": look(post=True, occluded_width=0.12), "right": look()},
    )
    alone = measure_sphere(left.pixels)  # one image cannot know: the glare shows more of its rim
    assert alone.centre_px == pytest.approx((350.0, 500.0), abs=5.0)
    assert pair_error_um(locate_sphere(left, right, head.calibration)) < 3.0


@pytest.mark.slow
@pytest.mark.hazard(27)
def test_a_glare_of_another_size_does_not_disturb_the_sphere(renderer, head, look):
    left, right = pair(renderer, head, look, scenes=(disc(300, 500, 180), disc(1700, 600, 190)))
    low, high = radius_range_px(head.calibration.left, 11.5)
    assert 190 < low < 261.4 < high
    found = locate_sphere(left, right, head.calibration)
    assert pair_error_um(found) < 2.0


@pytest.mark.hazard(27)
def test_two_spheres_are_distinguished_by_where_the_lines_of_sight_meet(renderer, head, look):
    other = np.array([-14.0, 3.0, 5.0])
    scenes = [renderer.sphere(head.in_camera(side, other), look()) for side in ("left", "right")]
    left, right = pair(renderer, head, look, scenes=scenes, looks={"left": look(), "right": look(post=True)})
    found = locate_sphere(left, right, head.calibration)
    assert min(pair_error_um(found), pair_error_um(found, other)) < 3.0
    assert len(measure_spheres(left.pixels)) == 2


@pytest.mark.hazard(27)
def test_images_of_two_different_spheres_are_refused(renderer, head, look):
    far = np.array([0.0, 7.0, 0.0])
    left = pair(renderer, head, look)[0]
    right = pair(renderer, head, look, point=far)[1]
    with pytest.raises(RaysDoNotMeet, match="STE-005"):
        locate_sphere(left, right, head.calibration)


@pytest.mark.hazard(27)
def test_too_little_rim_in_one_image_gives_outlines_but_no_point(renderer, head, look):
    left, right = pair(renderer, head, look, looks={"left": look(), "right": look(occluded_width=0.36)})
    found = locate_sphere(left, right, head.calibration)
    assert found.point is None
    assert found.left.status == "OK"
    assert found.right.status == "UNRELIABLE"
    assert found.doubt == "right camera: too much of the rim is hidden"


def test_areas_of_interest_give_the_same_point_as_the_whole_sensors(renderer, head, look):
    whole = pair(renderer, head, look)
    cut = [AreaImage(image.pixels[32:1056, 512:1536], 512, 32) for image in whole]
    points = [locate_sphere(*images, head.calibration).point.position_mm for images in (whole, cut)]
    assert points[1] == pytest.approx(points[0], abs=3e-4)


def test_an_image_without_a_sphere_is_refused(renderer, head, look):
    left = pair(renderer, head, look)[0]
    with pytest.raises(NoSphere, match="STE-003: right camera: no sphere in view"):
        locate_sphere(left, AreaImage(disc(1000, 500, 100).astype(np.uint8)), head.calibration)


def test_a_fault_in_either_image_is_reported_with_its_camera(renderer, head, look):
    black, white = (AreaImage(np.full((1088, 2048), level, np.uint8)) for level in (3, 255))
    good = pair(renderer, head, look)[0]
    for images, kind, said in (
        ((good, black), NoContrast, "right camera: the image is completely dark"),
        ((black, black), NoContrast, "both cameras: the image is completely dark"),
        ((black, white), Saturated, "left camera: the image is completely dark; right camera: .* saturated"),
    ):
        with raises(kind, match=said):
            locate_sphere(*images, head.calibration)


def test_a_range_of_radii_given_the_wrong_way_round_is_refused(renderer, look):
    with raises(BAD_MEASUREMENT, match="80 to 20 px"):
        measure_sphere(renderer.sphere(NOMINAL, look()), radius_range_px=(80.0, 20.0))
    with raises(BAD_MEASUREMENT, match=r"no pair.*got 20"):
        measure_sphere(renderer.sphere(NOMINAL, look()), radius_range_px=20)
    with pytest.raises(WrongArgument, match="ARG-001: the calibration"):
        locate_sphere(*[None] * 3)


def test_a_sphere_outside_the_given_range_is_reported_with_the_range(renderer, look):
    with pytest.raises(NoSphere, match="with a radius of 10 to 20 px"):
        measure_sphere(renderer.sphere(NOMINAL, look()), radius_range_px=(10.0, 20.0))
