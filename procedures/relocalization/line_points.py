"""Points of a laser line in the tool frame, from its centres in both images of the stereo head.

Both images are turned as if the cameras stood side by side, so that a point has the same height in both: the
centre of one is found between two centres of the other. The plane of the light need not be known. Where one
row shows several pieces, the plane that most points share says which belong together, and how far a point is
from it says whether the match is right. A line on a smooth surface is nearly straight, so one alone hardly
tells its plane: `light_plane` puts many together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.errors import LINES_DO_NOT_MATCH, NOT_IN_A_PLANE
from procedures.relocalization.laser_line import LineImage
from procedures.relocalization.light_plane import LightPlane, fit_plane
from procedures.relocalization.triangulation import CameraModel, camera_model, require_calibration
from ronna_hw.arrays import Array, Mask
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.frames import Frame

LARGEST_STEEPNESS = 4.0  # of the line against the epipolar lines: sideways over along; 14 degrees
LONGEST_GAP_PX = 80.0  # between two centres between which is interpolated
HEIGHT_ERROR_PX = (
    0.2  # of one image against the other, by the calibration and the lens; one standard deviation
)
FEWEST_POINTS = 3
PLANE_TOLERANCE_MM = 0.15  # of a right match, besides ...
PLANE_SIGMAS = 4.0  # ... this many of its standard deviations
LEAST_IN_PLANE = 0.5  # of the matched points
# Depth of light that skin scattered, over the depth by which a wider filter sees the line deeper. By path
# tracing 2.0 to 3.1 where up to half of the light comes from inside, 6 to 8 where all of it does.
DEPTH_OVER_GLOW = 2.3


@dataclass(frozen=True)
class LinePoints:
    """Points (n, 3) of a line in the tool frame, mm, with covariance and distance (n,) from their plane.

    The covariance (n, 3, 3) is that of the measurement; along the line it says how far both images may be out
    of level. `glow_mm` is the depth by which light from inside the skin displaced the line. It is taken out
    of the points, as far as the glow beside the line tells it. `unmatched` counts centres of the left image
    without a partner, `off_plane` those whose match is wrong.
    """

    points_mm: Array
    covariance_mm2: Array
    plane_distance_mm: Array
    plane: LightPlane
    glow_mm: float
    unmatched: int
    off_plane: int


@dataclass(frozen=True)
class _Candidates:
    """Matches: number of the left centre, that of both branches as a pair, points, covariance and glow."""

    left: NDArray[np.int64]
    pair: NDArray[np.int64]
    points_mm: Array
    covariance_mm2: Array
    glow_mm: Array


def triangulate_line(
    left: LineImage,
    right: LineImage,
    calibration: StereoHeadCalibration,
    plane: LightPlane | None = None,
) -> LinePoints:
    """Return the points that both images show, in the tool frame.

    `plane` is that of the light where it is known, else it is fitted. Raises STE-016 where the images have no
    part in common or the line runs along the baseline, STE-017 where fewer than half of the points lie in a
    plane, ARG-001 for what is no calibration.
    """
    require_calibration(calibration)
    level = _level_head(calibration)
    candidates = _match(level, level.place(left, 0), level.place(right, 1))
    count = len(np.unique(candidates.left))
    if count < FEWEST_POINTS:
        raise LINES_DO_NOT_MATCH(
            "the line cannot be followed from one image to the other",
            expected=f"{FEWEST_POINTS} centres with a partner, of {len(left.branch)} and {len(right.branch)}",
            got=f"{count}",
        )
    chosen_plane = plane or _vote(candidates)
    distance = chosen_plane.distance_mm(candidates.points_mm)
    tolerance = PLANE_TOLERANCE_MM + PLANE_SIGMAS * chosen_plane.deviation_mm(candidates.covariance_mm2)
    chosen = _choose_nearest(candidates.left, np.abs(distance))
    kept = chosen & (np.abs(distance) < tolerance)
    if kept.sum() < max(FEWEST_POINTS, LEAST_IN_PLANE * count):
        raise NOT_IN_A_PLANE(
            "the points of the line do not lie in a plane",
            limit=f"{LEAST_IN_PLANE:.0%} of them within {PLANE_TOLERANCE_MM} mm",
            got=f"{int(kept.sum())} of {count}",
        )
    glow_mm = DEPTH_OVER_GLOW * float(np.median(candidates.glow_mm[kept]))
    return LinePoints(
        points_mm=candidates.points_mm[kept] - glow_mm * level.axes[2],
        covariance_mm2=candidates.covariance_mm2[kept],
        plane_distance_mm=distance[kept],
        plane=chosen_plane,
        glow_mm=glow_mm,
        unmatched=len(left.branch) - count,
        off_plane=count - int(kept.sum()),
    )


@dataclass(frozen=True)
class _LevelLine:
    """Centres of a line in a level image: sideways u, height v, deviation of u at that height, and branch.

    `glow` is the displacement of u by a wider filter.
    """

    u: Array
    v: Array
    sigma: Array
    glow: Array
    steepness: Array
    branch: NDArray[np.int64]


class _LevelHead:
    """Both cameras turned in place: x along the baseline, z along their common view."""

    def __init__(self, calibration: StereoHeadCalibration) -> None:
        self._cameras: tuple[CameraModel, CameraModel] = (
            camera_model(calibration.left, Frame.CAMERA_LEFT),
            camera_model(calibration.right, Frame.CAMERA_RIGHT),
        )
        self._focal_px = [np.sqrt(np.prod(each.focal_px)) for each in (calibration.left, calibration.right)]
        first, second = (camera.centre_mm for camera in self._cameras)
        self.baseline_mm = float(np.linalg.norm(second - first))
        x = (second - first) / self.baseline_mm
        view = sum(camera.rotation[2] for camera in self._cameras)
        z = view - (view @ x) * x
        z /= np.linalg.norm(z)
        self.axes = np.stack([x, np.cross(z, x), z])  # level <- tool
        self.origin_mm = first
        self.height_error = HEIGHT_ERROR_PX / float(np.mean(self._focal_px))

    def place(self, line: LineImage, side: int) -> _LevelLine:
        """Return the centres of one camera in its level image."""
        both = np.concatenate([line.centres_px, line.centres_px + line.deviation_px])
        (u, moved_u), (v, moved_v) = (np.split(each, 2) for each in self._level(both, side))
        steepness = _slopes(u, v, line.branch)
        across = moved_u - u - np.where(np.isfinite(steepness), steepness, 0.0) * (moved_v - v)
        square = (line.deviation_px**2).sum(axis=1)
        glow = across * (line.glow_px * line.deviation_px).sum(axis=1) / square
        return _LevelLine(u, v, np.abs(across), glow, steepness, line.branch)

    def _level(self, pixels: Array, side: int) -> tuple[Array, Array]:
        camera = self._cameras[side]
        seen = camera.undistort(pixels)
        rays = np.column_stack([seen, np.ones(len(seen))]) @ camera.rotation @ self.axes.T
        return rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]

    def triangulate(self, u: tuple[Array, Array], v: Array) -> tuple[Array, Array]:
        """Return points (n, 3) in the tool frame and their Jacobian (n, 3, 3) by u left, u right and v."""
        depth = self.baseline_mm / (u[0] - u[1])
        rays = np.stack([u[0], v, np.ones(len(v))], axis=1)
        by_depth = depth[:, None] * rays
        shrink = depth / self.baseline_mm
        jacobian = np.stack([-shrink[:, None] * by_depth, shrink[:, None] * by_depth, 0.0 * by_depth], axis=2)
        jacobian[:, 0, 0] += depth
        jacobian[:, 1, 2] += depth
        return by_depth @ self.axes + self.origin_mm, self.axes.T @ jacobian


@lru_cache(maxsize=4)  # a scan asks for the same head at each line
def _level_head(calibration: StereoHeadCalibration) -> _LevelHead:
    return _LevelHead(calibration)


def _slopes(u: Array, v: Array, branch: NDArray[np.int64]) -> Array:
    """Return du/dv along each branch; infinite for a branch of a single centre."""
    slopes = np.full(len(u), np.inf)
    for each in np.unique(branch):
        own = np.flatnonzero(branch == each)
        if len(own) > 1:
            rise, run = np.gradient(u[own]), np.gradient(v[own])
            is_level = np.abs(run) * LARGEST_STEEPNESS < np.abs(rise)
            slopes[own] = np.where(is_level, np.inf, rise / np.where(is_level, 1.0, run))
    return slopes


def _match(level: _LevelHead, left: _LevelLine, right: _LevelLine) -> _Candidates:
    """Return every pair of a left centre and a place between two right ones at the same height."""
    longest = LONGEST_GAP_PX * level.height_error / HEIGHT_ERROR_PX
    usable = np.abs(left.steepness) < LARGEST_STEEPNESS
    left_rows: list[NDArray[np.intp]] = []
    partners: list[NDArray[np.int64]] = []
    columns: list[Array] = []
    for branch in np.unique(right.branch):
        own = np.flatnonzero((right.branch == branch) & (np.abs(right.steepness) < LARGEST_STEEPNESS))
        own = own[np.argsort(right.v[own])]
        if len(own) < 2:
            continue
        v = right.v[own]
        after = np.clip(np.searchsorted(v, left.v), 1, len(own) - 1)
        gap = v[after] - v[after - 1]
        share = (left.v - v[after - 1]) / np.where(gap > 0.0, gap, np.inf)
        met = np.flatnonzero(usable & (share >= 0.0) & (share <= 1.0) & (gap > 0.0) & (gap < longest))
        before, behind, part = own[after[met] - 1], own[after[met]], share[met]
        u = (1.0 - part) * right.u[before] + part * right.u[behind]
        sigma = np.hypot((1.0 - part) * right.sigma[before], part * right.sigma[behind])
        in_front = left.u[met] > u
        left_rows.append(met[in_front])
        partners.append(np.full(int(in_front.sum()), branch))
        columns.append(np.stack([u, sigma, right.steepness[before], right.glow[before]])[:, in_front])
    met = np.concatenate([np.zeros(0, np.intp), *left_rows])
    partner = np.concatenate([np.zeros(0, np.int64), *partners])
    u, sigma, steepness, glow = np.concatenate([np.zeros((4, 0)), *columns], axis=1)
    points, jacobian = level.triangulate((left.u[met], u), left.v[met])
    # An error of height moves the partner along the right line.
    variance = np.stack(
        [
            left.sigma[met] ** 2,
            sigma**2 + (steepness * level.height_error) ** 2,
            np.full(len(met), level.height_error**2),
        ],
        axis=1,
    )
    covariance = (jacobian * variance[:, None, :]) @ jacobian.transpose(0, 2, 1)
    pair = left.branch[met] * (int(right.branch.max(initial=0)) + 1) + partner
    deeper = level.axes[2] @ (jacobian[:, :, 0].T * left.glow[met] + jacobian[:, :, 1].T * glow)
    return _Candidates(met, pair, points, 0.5 * (covariance + covariance.transpose(0, 2, 1)), deeper)


def _vote(candidates: _Candidates) -> LightPlane:
    """Return the plane that most left centres share, fitted to those that do."""
    best: Mask = np.ones(len(candidates.left), bool)
    most = 0
    for pair in np.unique(candidates.pair):
        own = candidates.pair == pair
        if own.sum() < FEWEST_POINTS:
            continue
        near = np.abs(fit_plane(candidates.points_mm[own]).distance_mm(candidates.points_mm))
        inside = _choose_nearest(candidates.left, near) & (near < PLANE_TOLERANCE_MM)
        if inside.sum() > most:
            best, most = inside, int(inside.sum())
    return fit_plane(candidates.points_mm[best])


def _choose_nearest(left: NDArray[np.int64], distance: Array) -> Mask:
    """Mark the candidate with the least distance of each left centre."""
    order = np.lexsort((distance, left))
    first = np.ones(len(order), bool)
    first[1:] = left[order][1:] != left[order][:-1]
    chosen = np.zeros(len(order), bool)
    chosen[order[first]] = True
    return chosen
