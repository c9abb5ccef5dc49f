"""One sphere in both images, among look-alikes in one of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from procedures.relocalization import AreaImage, locate_sphere, measure_sphere, measure_spheres
from procedures.relocalization.errors import NoContrast, NoSphere, RaysDoNotMeet, Saturated
from procedures.relocalization.sphere_measurement import radius_range_px

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


def error_um(sighting, point=PLACE_MM):
    return 1e3 * float(np.linalg.norm(sighting.point.position_mm - point))


def test_a_single_sphere_is_located(renderer, head, look):
    assert error_um(locate_sphere(*pair(renderer, head, look), head.calibration)) < 2.0


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
    assert error_um(locate_sphere(left, right, head.calibration)) < 3.0


@pytest.mark.hazard(27)
def test_a_glare_of_another_size_does_not_disturb_the_sphere(renderer, head, look):
    left, right = pair(renderer, head, look, scenes=(disc(300, 500, 180), disc(1700, 600, 190)))
    low, high = radius_range_px(head.calibration.left, 11.5)
    assert 190 < low < 261.4 < high
    found = locate_sphere(left, right, head.calibration)
    assert error_um(found) < 2.0


@pytest.mark.hazard(27)
def test_two_spheres_are_distinguished_by_where_the_lines_of_sight_meet(renderer, head, look):
    other = np.array([-14.0, 3.0, 5.0])
    scenes = [renderer.sphere(head.in_camera(side, other), look()) for side in ("left", "right")]
    left, right = pair(renderer, head, look, scenes=scenes, looks={"left": look(), "right": look(post=True)})
    found = locate_sphere(left, right, head.calibration)
    assert min(error_um(found), error_um(found, other)) < 3.0
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
        with pytest.raises(kind, match=said):
            locate_sphere(*images, head.calibration)
