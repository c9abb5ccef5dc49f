"""From two outlines to a point in the tool frame: bias, distortion, checks, and images with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation

from procedures.relocalization import SphereImage, SphereStatus, measure_sphere, triangulate
from procedures.relocalization.ellipse import circle_as_ellipse, fit_ellipse
from procedures.relocalization.errors import BAD_MEASUREMENT, WRONG_CAMERA, RaysDoNotMeet, WrongSize
from procedures.relocalization.triangulation import CameraModel, check_serial
from ronna_hw.calibration import CameraCalibration, PoseRecord

FOCAL_PX = 62.5e3 / 5.5
RADIUS_MM = 5.75


def outline(centre_px, semi_minor_px, semi_major_px=None, status=SphereStatus.OK):
    return SphereImage(
        centre_px=(float(centre_px[0]), float(centre_px[1])),
        axes_px=(float(semi_major_px or semi_minor_px), float(semi_minor_px)),
        quality=1.0,
        status=status,
        covariance_px2=((1e-4, 0.0), (0.0, 1e-4)),
        rim_fraction=1.0,
        scatter_px=0.05,
        blur_px=1.0,
    )


def exact_outline(camera, centre_mm, radius_mm=RADIUS_MM):
    """The outline by its definition: tangent rays of the sphere, projected, and an ellipse through them."""
    distance = np.linalg.norm(centre_mm)
    axis = centre_mm / distance
    side = np.cross(axis, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    angle = np.linspace(0.0, 2 * np.pi, 200, endpoint=False)[:, None]
    sine = radius_mm / distance
    rays = np.sqrt(1 - sine**2) * axis + sine * (np.cos(angle) * side + np.sin(angle) * up)
    points = np.array([camera.to_pixel(ray[:2] / ray[2]) for ray in rays])
    middle = points.mean(axis=0)
    start = circle_as_ellipse(tuple(middle), float(np.hypot(*(points - middle).T).mean()))
    fit = fit_ellipse(points, start)
    major, minor = fit.ellipse.axes_px
    return outline(fit.ellipse.centre_px, minor, major)


def bare_camera(**changes):
    values = {
        "serial": "bare",
        "focal_px": (FOCAL_PX, FOCAL_PX),
        "principal_point_px": (1023.5, 543.5),
        "camera_from_tool": PoseRecord(translation_mm=(0, 0, 0), quaternion_wxyz=(1, 0, 0, 0)),
    }
    return CameraModel(CameraCalibration(**{**values, **changes}))


@pytest.mark.parametrize("x_mm", [0.0, 3.0, 10.0, 20.0])
def test_the_perspective_bias_is_removed_exactly(x_mm):
    camera = bare_camera()
    centre = np.array([x_mm, -0.3 * x_mm, 250.0])
    found = camera.centre_of(exact_outline(camera, centre))
    assert found == pytest.approx(centre[:2] / centre[2], abs=1e-9)


def test_the_bias_three_millimetres_off_axis_is_one_and_a_half_micrometres():
    camera = bare_camera()
    raw = camera.undistort(exact_outline(camera, np.array([3.0, 0.0, 250.0])).centre_px)
    assert (raw[0] * 250.0 - 3.0) * 1e3 == pytest.approx(1.6, abs=0.2)


def test_the_angular_radius_matches_the_sphere():
    camera = bare_camera()
    centre = np.array([12.0, 5.0, 240.0])
    sine = np.sin(camera.angular_radius_rad(exact_outline(camera, centre)))
    assert sine * np.linalg.norm(centre) == pytest.approx(RADIUS_MM, abs=1e-6)


def test_distortion_is_removed():
    camera = bare_camera(distortion=(-0.08, 0.02, 4e-4, -3e-4, 0.001))
    ideal = np.array([0.085, -0.045])
    assert camera.undistort(camera.to_pixel(ideal)) == pytest.approx(ideal, abs=1e-12)


def test_the_bias_correction_holds_under_distortion():
    camera = bare_camera(distortion=(-0.05, 0.0, 0.0, 0.0, 0.0))
    centre = np.array([10.0, 4.0, 250.0])
    found = camera.centre_of(exact_outline(camera, centre))
    assert np.abs(found * 250.0 - centre[:2]).max() < 1e-3  # mm


def exact_pair(head, point_mm, radius_mm=RADIUS_MM):
    return [
        exact_outline(
            bare_camera(principal_point_px=head.principal_px), head.in_camera(side, point_mm), radius_mm
        )
        for side in ("left", "right")
    ]


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (2.5, -1.5, 3.0), (-6.0, 4.0, -5.0)])
def test_exact_outlines_give_the_exact_point(head, point):
    found = triangulate(*exact_pair(head, np.array(point)), head.calibration)
    assert found.position_mm == pytest.approx(np.array(point), abs=1e-6)
    assert found.ray_gap_mm < 1e-6
    assert found.radius_mm == pytest.approx(RADIUS_MM, abs=1e-5)


@pytest.mark.parametrize("draws", [200, pytest.param(400, marks=pytest.mark.slow)])
def test_the_covariance_matches_repeated_noise(head, draws):
    generator = np.random.default_rng(2)
    pair = exact_pair(head, np.array([1.0, 2.0, -1.0]))
    points = []
    for _ in range(draws):
        noisy = [
            replace(side, centre_px=tuple(np.array(side.centre_px) + generator.normal(0, 0.01, 2)))
            for side in pair
        ]
        points.append(triangulate(*noisy, head.calibration).position_mm)
    predicted = triangulate(*pair, head.calibration).covariance_mm2
    observed = np.cov(np.array(points).T)
    assert np.diag(observed) == pytest.approx(np.diag(predicted), rel=0.25)
    # depth is worse than the plane across it: 1 / sin and 1 / cos of half the angle between the cameras
    assert np.sqrt(predicted[2, 2] / predicted[0, 0]) == pytest.approx(1 / np.tan(np.radians(27.5)), rel=0.02)


def test_offsets_of_an_area_of_interest_are_added_before_triangulation(head):
    left, right = exact_pair(head, np.array([1.0, 0.5, 0.0]))
    cut = left.with_offset(-512, -256)
    assert cut.centre_px[0] == pytest.approx(left.centre_px[0] - 512)
    found = triangulate(cut.with_offset(512, 256), right, head.calibration)
    assert found.position_mm == pytest.approx([1.0, 0.5, 0.0], abs=1e-6)


@pytest.mark.hazard(27)
def test_lines_of_sight_to_two_spheres_do_not_meet(head):
    left = exact_pair(head, np.array([0.0, 0.0, 0.0]))[0]
    right = exact_pair(head, np.array([0.0, 6.0, 0.0]))[1]
    with pytest.raises(RaysDoNotMeet, match="STE-005"):
        triangulate(left, right, head.calibration)


@pytest.mark.hazard(26)
def test_a_twisted_camera_shows_in_the_ray_gap(head):
    pair = exact_pair(head, np.zeros(3))
    pose = head.calibration.right.camera_from_tool
    twist = Rotation.from_euler("x", 0.05, degrees=True)
    turn = twist * Rotation.from_quat(pose.quaternion_wxyz, scalar_first=True)
    twisted = PoseRecord(
        translation_mm=tuple(twist.apply(pose.translation_mm).tolist()),
        quaternion_wxyz=tuple(turn.as_quat(scalar_first=True).tolist()),
    )
    calibration = head.calibration.model_copy(
        update={"right": head.calibration.right.model_copy(update={"camera_from_tool": twisted})}
    )
    assert triangulate(*pair, calibration).ray_gap_mm == pytest.approx(250.0 * np.radians(0.05), rel=0.05)


@pytest.mark.parametrize("radius_mm", [5.0, 6.5])
@pytest.mark.hazard(27)
def test_a_sphere_of_another_diameter_is_refused(head, radius_mm):
    with pytest.raises(WrongSize, match="STE-006"):
        triangulate(*exact_pair(head, np.zeros(3), radius_mm), head.calibration)


@pytest.mark.hazard(27)
def test_outlines_of_different_sizes_are_not_taken_for_one_sphere(head):
    left, right = exact_pair(head, np.zeros(3))
    larger = replace(right, axes_px=tuple(1.02 * axis for axis in right.axes_px))
    with pytest.raises(WrongSize, match="STE-006: the two images do not show the same sphere"):
        triangulate(left, larger, head.calibration)


@pytest.mark.parametrize("centre", [(np.nan, 0.0), (np.inf, 3.0)])
def test_non_finite_coordinates_are_refused(head, centre):
    left, right = exact_pair(head, np.zeros(3))
    with raises(BAD_MEASUREMENT, match="STE-004"):
        triangulate(replace(left, centre_px=centre), right, head.calibration)


@pytest.mark.hazard(25)
def test_a_calibration_for_another_camera_is_refused(head):
    check_serial(head.calibration.left, "left")
    with raises(WRONG_CAMERA, match="STE-010"):
        check_serial(head.calibration.left, "24000001")


@pytest.mark.parametrize(
    ("changes", "reach_mm", "limit_um"),
    [
        ({"post": True}, 0.3, 2.0),
        ({"post": True, "stains": 3}, 2.0, 2.0),
        ({"blur_px": 3.0}, 0.3, 2.5),
        ({"occluded_width": 0.2, "stains": 2}, 1.0, 5.0),
    ],
    ids=["centred", "stained", "defocused", "occluded"],
)
@pytest.mark.parametrize("pairs", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_images_give_the_point_to_a_few_micrometres(renderer, head, look, changes, reach_mm, limit_um, pairs):
    errors = []
    for _ in range(pairs):
        point = renderer.random.uniform(-reach_mm, reach_mm, 3)
        pair = [
            measure_sphere(renderer.sphere(head.in_camera(side, point), look(**changes)))
            for side in ("left", "right")
        ]
        errors.append(triangulate(*pair, head.calibration).position_mm - point)
    assert 1e3 * float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))) < limit_um
