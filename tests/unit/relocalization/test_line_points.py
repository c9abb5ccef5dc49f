"""Lines in both images become points on the surface, with an honest covariance and a check by their plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from procedures.relocalization.laser_line import LineImage
from procedures.relocalization.light_plane import LineRecord, fit_plane, record_line
from procedures.relocalization.line_points import DEPTH_OVER_GLOW, LinePoints, triangulate_line
from procedures.relocalization.triangulation import camera_model
from ronna_hw.arrays import Array
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.errors import DataError, RefusedError
from ronna_hw.frames import Frame

SPACING_MM = 0.7
SIGMA_PX = 0.1


def straight(count: int = 30, depth_mm: float = 0.0) -> Array:
    """Points of a line on a plane at right angles to the tool axis."""
    along = (np.arange(count) - count / 2 + 0.3) * SPACING_MM
    return np.stack([0.0 * along, along, 0.0 * along + depth_mm], axis=1)


def on_head(radius_mm: float = 40.0) -> Array:
    """Points of a line on a curved surface."""
    points = straight()
    points[:, 2] = radius_mm - np.sqrt(radius_mm**2 - points[:, 1] ** 2)
    return points


class Head:
    """A stereo head, and the images of lines in it."""

    def __init__(self, calibration: StereoHeadCalibration, seed: int = 0) -> None:
        self.calibration = calibration
        self._cameras = (
            camera_model(calibration.left, Frame.CAMERA_LEFT),
            camera_model(calibration.right, Frame.CAMERA_RIGHT),
        )
        self._random = np.random.default_rng(seed)

    def see(self, side: int, *pieces: Array, sigma_px: float = 0.0) -> LineImage:
        pixels = [np.array([self._cameras[side].project(point)[0] for point in piece]) for piece in pieces]
        branch = np.repeat(np.arange(len(pieces)), [len(each) for each in pieces])
        centres = np.concatenate(pixels)
        centres[:, 0] += sigma_px * self._random.standard_normal(len(centres))
        deviation = np.tile([max(sigma_px, 1e-3), 0.0], (len(centres), 1))
        ones = np.ones(len(centres))
        return LineImage(
            centres, deviation, branch, 5.0 * ones, 100.0 * ones, 0.0 * ones, np.zeros((len(centres), 2))
        )

    def scan(self, *pieces: Array, sigma_px: float = 0.0) -> LinePoints:
        left, right = (self.see(side, *pieces, sigma_px=sigma_px) for side in (0, 1))
        return triangulate_line(left, right, self.calibration)


@pytest.fixture
def eyes(head: object) -> Head:
    return Head(head.calibration)  # type: ignore[attr-defined]


def test_points_lie_on_the_surface(eyes: Head) -> None:
    truth = on_head()

    points = eyes.scan(truth)

    depth = 40.0 - np.sqrt(40.0**2 - points.points_mm[:, 1] ** 2)
    assert len(points.points_mm) >= len(truth) - 2
    assert np.abs(points.points_mm[:, 2] - depth).max() < 0.003  # straight between two centres
    assert np.abs(points.points_mm[:, 0]).max() < 0.002


def test_the_covariance_is_as_large_as_the_scatter_off_the_line(eyes: Head) -> None:
    squares = []
    for _ in range(12):
        found = eyes.scan(straight(), sigma_px=SIGMA_PX)
        across = found.points_mm[:, [0, 2]]  # where along the line a point lies, is its own affair
        inverse = np.linalg.inv(found.covariance_mm2[:, [[0], [2]], [0, 2]])
        squares.append(np.einsum("ni,nij,nj->n", across, inverse, across))

    assert 0.7 < np.mean(np.concatenate(squares)) / 2.0 < 1.3


def test_points_are_lifted_by_as_much_as_the_glow_beside_the_line_says_it_lies_too_deep(eyes: Head) -> None:
    true = on_head()
    left, right = (eyes.see(side, true) for side in (0, 1))
    deeper = [eyes.see(side, true + np.array([0.0, 0.0, 0.02])).centres_px for side in (0, 1)]
    glowing = [
        replace(line, glow_px=(seen - line.centres_px) * [1.0, 0.0])
        for line, seen in zip((left, right), deeper, strict=True)
    ]

    found = triangulate_line(glowing[0], glowing[1], eyes.calibration)
    plain = triangulate_line(left, right, eyes.calibration)

    assert found.glow_mm == pytest.approx(DEPTH_OVER_GLOW * 0.02, rel=0.05)
    np.testing.assert_allclose(plain.points_mm[:, 2] - found.points_mm[:, 2], found.glow_mm, rtol=0.02)
    assert plain.glow_mm == 0.0


def test_both_pieces_at_the_edge_of_an_ear_are_matched_by_their_plane(eyes: Head) -> None:
    near, far = straight(16), straight(30, depth_mm=9.0)
    near[:, 1] += 4.0

    found = eyes.scan(near, far)

    depth = found.points_mm[:, 2]
    assert np.all(np.minimum(np.abs(depth), np.abs(depth - 9.0)) < 0.01)
    assert (depth < 1.0).sum() >= 14
    assert (depth > 8.0).sum() >= 26


def test_a_partner_on_another_surface_is_left_out(eyes: Head) -> None:
    line = on_head(30.0)
    stray = straight(8, depth_mm=3.0) + np.array([1.5, 0.0, 0.0])

    right = eyes.see(1, line, stray)
    found = triangulate_line(eyes.see(0, line[:20], stray), right, eyes.calibration)

    assert np.abs(found.points_mm[:, 0]).max() < 0.15
    assert found.off_plane >= 0


def test_lines_that_show_different_parts_are_refused(eyes: Head) -> None:
    line = straight()
    with pytest.raises(DataError, match="STE-016"):
        triangulate_line(eyes.see(0, line[:12]), eyes.see(1, line[20:]), eyes.calibration)


def test_a_line_along_the_baseline_is_refused(eyes: Head) -> None:
    along = straight()[:, [1, 0, 2]]
    with pytest.raises(DataError, match="STE-016"):
        eyes.scan(along)


def test_points_in_no_plane_are_refused(eyes: Head) -> None:
    scattered = straight()
    scattered[:, [0, 2]] += np.random.default_rng(5).uniform(-2.0, 2.0, (30, 2))
    with pytest.raises(DataError, match="STE-017"):
        eyes.scan(scattered)


def test_numbers_that_are_not_finite_are_refused(eyes: Head) -> None:
    line = eyes.see(0, straight())
    broken = replace(line, centres_px=np.full_like(line.centres_px, np.nan))
    with pytest.raises(DataError, match="STE-004"):
        triangulate_line(broken, eyes.see(1, straight()), eyes.calibration)


def recorded(tilt_rad: float = 0.0, shift_mm: float = 0.0, width_mm: float = 0.1) -> LineRecord:
    lines = [straight(depth_mm=depth) for depth in (-6.0, 0.0, 6.0)]
    turn = Rotation.from_euler("y", tilt_rad).as_matrix()
    return record_line([line @ turn.T + np.array([shift_mm, 0.0, 0.0]) for line in lines], [width_mm] * 3)


def test_the_plane_of_the_light_is_recorded_from_lines_at_several_distances() -> None:
    record = recorded()

    np.testing.assert_allclose(np.abs(record.plane.normal), [1.0, 0.0, 0.0], atol=1e-9)
    assert record.plane.spread_mm[1] > 4.0
    record.require_same(recorded())


@pytest.mark.parametrize(
    "changed", [recorded(tilt_rad=0.01), recorded(shift_mm=0.2), recorded(width_mm=0.15)]
)
def test_a_projector_that_moved_is_noticed(changed: LineRecord) -> None:
    with pytest.raises(RefusedError, match="STE-018"):
        recorded().require_same(changed)


def test_a_plane_needs_no_order_of_its_points() -> None:
    points = on_head()
    one, other = fit_plane(points), fit_plane(points[::-1])
    np.testing.assert_allclose(one.normal, other.normal, atol=1e-9)
