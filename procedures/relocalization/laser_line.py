"""Centre of a laser line in an image at sub-pixel, with its standard deviation.

The centre is where the derivative of a Gaussian as wide as the line, laid across it, sees as much light on
either side. Such a filter does not see even ambient light, nor the clipped top of a saturated line, and
little of the halo of light that was scattered in skin. Rows are put together over some spacing along the
line: one row sees a few grains of speckle only. Speckle grows with the light, so that the flanks say more of
the centre than their light would make them: as much of a wider filter is added as makes the rows agree best.
`line_course` smooths what is left along the line.

The standard deviation has three parts: the scatter of shorter blocks of rows, longer than a grain of speckle;
the asymmetry of the profile, seen as the shift between two filters of different width; and the mottle of
skin. Mottle shifts the line alike in both images, along the skin, so that no point leaves the surface. A
picture without the line shows it under other light, and the shift is taken out as far as it does.

Light that was scattered inside skin comes back from below its surface, most of it beside the line. `glow_px`
is how far a wider filter sees it from the centre: its sign differs between the images, and `line_points`
tells from it how much too deep the line appears.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.errors import BadImage, NoLine, Saturated
from procedures.relocalization.grey_image import (
    AreaImage,
    GreyImage,
    halve_image,
    highest_grey,
    single_threaded,
    validate_image,
)
from procedures.relocalization.line_course import smooth_course
from procedures.relocalization.line_profiles import LineProfiles
from procedures.relocalization.line_ridges import HALVINGS, Ridges, find_ridges, mark_changes, runs_along_rows
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import MAD_TO_SIGMA, median

SPACING_PX = 32  # of the centres along the line: 0.7 mm at the tool centre point
BLOCK_PX = 8  # of rows whose scatter is looked at: a grain of speckle is 2 px
FIRST_SIGMA_PX, LEAST_SIGMA_PX, LARGEST_SIGMA_PX = 8.0, 1.5, 12.0  # of the filter
WINDOW_SIGMAS = 3.0
HALVING_PX2 = 0.5  # variance that halving the image and whole columns of it add to the width
LARGEST_BLEND = 3.0  # of the difference between both filters; speckle wants 1.5 to 3
WIDE_FILTER = 1.6  # over the usual one, for the asymmetry
ASYMMETRY_SHARE = 0.5  # of the shift between both filters; of the error that a tail on one side leaves
CLIPPED_SHARE = 0.05  # of the filter's width: error of a centre whose whole core is clipped
# Relative change of the reflectance of skin across the line: it shifts the centre by the line's variance
# times this, and leaves no sign. Fitted to path-traced skin mottled by 10 % in blotches of all sizes (U).
MOTTLE_PER_PX = 0.006
FINE_MOTTLE = 0.5  # share of its variance in blotches that are new in the next group of rows
UNSEEN_MOTTLE = 0.15  # share of the mottle that a picture without the line leaves at best
# Shift over that by usual mottle: beyond, it is the edge of a shadow or lamp, which does not move the line.
LARGEST_MOTTLE = 1.3
LARGEST_STEP_PX = 12.0  # from the rough centre, at once
LEAST_LIGHT = 0.2  # of the usual curvature of the profile; with less, hair hides the line in this row
OUTLIER_SIGMAS, OUTLIER_FLOOR_PX = 4.0, 0.3
LEAST_ROWS = 0.5  # of a spacing
POOLED = 5  # centres whose scatter is put together: four blocks alone say little
LARGEST_DEVIATION_PX = 2.0
SATURATED_SHARE = 0.5  # of the image
TINY = 1e-12
GAUSSIAN_SLOPE = 0.5 * np.sqrt(np.pi)  # of the filter's answer, on a line of its width and unit height


@dataclass(frozen=True)
class LineImage:
    """Centres (n, 2) of a line in an image, px x and y, in order along each of its branches.

    `deviation_px` (n, 2) is one standard deviation, as a vector across the line: along it a centre is where
    it is by definition. `branch` (n,) numbers the pieces. `width_px` (n,) is the standard deviation of the
    profile, `grey` (n,) how far it stands out, `clipped` (n,) the saturated share of its core, `glow_px`
    (n, 2) the vector from the centre to that by a wider filter.
    """

    centres_px: Array
    deviation_px: Array
    branch: NDArray[np.int64]
    width_px: Array
    grey: Array
    clipped: Array
    glow_px: Array

    def with_offset(self, x_px: float, y_px: float) -> Self:
        """Return the line in pixels of the whole sensor, given the corner of the area."""
        return replace(self, centres_px=self.centres_px + np.array([x_px, y_px]))


def measure_line(lit: AreaImage, dark: AreaImage | None = None, *, spacing_px: int = SPACING_PX) -> LineImage:
    """Measure the line in an image of an area, in pixels of the whole sensor.

    `dark` is the same view without the line; without it, ambient light is taken from beside the line. Raises
    STE-001 for what is no image or two different areas, STE-011 when saturated, STE-015 without a line.
    """
    grey: GreyImage = validate_image(lit.pixels)
    light = grey if dark is None else _subtract(lit, dark)
    room = None if dark is None else dark.pixels
    half = halve_image(light, 1)
    small = halve_image(half, HALVINGS - 1)
    turned = runs_along_rows(small)
    if turned:
        grey, light, half, small = (_transposed(each) for each in (grey, light, half, small))
        room = None if room is None else _transposed(room)
    ridges = find_ridges(small)
    if not len(ridges.row):
        _refuse(grey, ridges)
    course, sigma_px = _follow(half, ridges, spacing_px)
    half_px = int(WINDOW_SIGMAS * WIDE_FILTER * sigma_px)
    line = _refine(LineProfiles(grey, light, room, course, half_px), course, sigma_px, spacing_px)
    if not len(line.branch):
        _refuse(grey, ridges)
    if turned:
        line = replace(
            line,
            centres_px=line.centres_px[:, ::-1],
            deviation_px=line.deviation_px[:, ::-1],
            glow_px=line.glow_px[:, ::-1],
        )
    return line.with_offset(lit.offset_x_px, lit.offset_y_px)


def _subtract(lit: AreaImage, dark: AreaImage) -> GreyImage:
    ambient = validate_image(dark.pixels)
    areas = [
        (each.offset_x_px, each.offset_y_px, *each.pixels.shape, each.pixels.dtype) for each in (lit, dark)
    ]
    if areas[0] != areas[1]:
        shapes = [f"{each[2]} x {each[3]} px, {each[4]}, at {each[0]}, {each[1]}" for each in areas]
        raise BadImage("the images with and without the line differ", expected=shapes[0], got=shapes[1])
    with single_threaded():
        light: GreyImage = cv2.subtract(validate_image(lit.pixels), ambient)
    return light


def _transposed(image: GreyImage) -> GreyImage:
    turned: GreyImage = np.ascontiguousarray(image.T)  # type: ignore[assignment]  # NumPy widens the dtype
    return turned


def _refuse(grey: GreyImage, ridges: Ridges) -> None:
    clipped = float(np.mean(grey[::4, ::4] >= highest_grey(grey)))
    if clipped > SATURATED_SHARE:
        raise Saturated("the image is saturated", limit=f"{SATURATED_SHARE:.0%}", got=f"{clipped:.0%} of it")
    raise NoLine(
        "no laser line in view",
        expected=f"a line {ridges.limit_grey:.0f} grey values above what is beside it",
        got=f"{ridges.strongest_grey:.1f}",
    )


def _follow(half: GreyImage, ridges: Ridges, spacing_px: int) -> tuple[Ridges, float]:
    """Return the course of the line, in straight pieces, and its width, from the image halved once."""
    own = replace(
        ridges, row=ridges.row[::2] // 2, column=0.5 * (ridges.column[::2] - 0.5), branch=ridges.branch[::2]
    )
    profiles = LineProfiles(half, half, None, own, int(0.5 * WINDOW_SIGMAS * LARGEST_SIGMA_PX))
    short = _Groups(own, spacing_px // 4)
    centre, sigma_px = own.column, FIRST_SIGMA_PX
    for about_course in (False, True):
        score, slope = profiles.weigh(centre, 0.5 * sigma_px).answer
        kept = _mark_lit(score, slope, about_course=about_course)
        centre = short.smooth(centre, score, slope, kept)
        core_px = np.sqrt(max((2.0 * profiles.core_sigma_px(centre)) ** 2 - HALVING_PX2, 0.0))
        sigma_px = float(np.clip(core_px, LEAST_SIGMA_PX, LARGEST_SIGMA_PX))
    column = np.empty(len(ridges.row))
    for branch in ridges.branch[mark_changes(ridges.branch)]:
        rows, known = ridges.branch == branch, own.branch == branch
        column[rows] = _interpolate(ridges.row[rows], 2.0 * own.row[known] + 0.5, 2.0 * centre[known] + 0.5)
    return replace(ridges, column=column), sigma_px


def _refine(profiles: LineProfiles, course: Ridges, sigma_px: float, spacing_px: int) -> LineImage:
    centre = course.column
    seen = profiles.weigh(centre, sigma_px)
    score, slope = seen.answer
    wide_score, wide_slope = profiles.weigh(centre, WIDE_FILTER * sigma_px).answer
    kept = _mark_lit(score, slope, about_course=True)
    groups, blocks = _Groups(course, spacing_px), _Groups(course, BLOCK_PX)
    count = groups.add(kept)
    clipped = groups.mean(profiles.clipped_share(centre, sigma_px), kept)
    weight = np.where(kept, slope, 0.0)
    total = groups.add(weight)
    over = 1.0 / np.maximum(total, TINY)
    shift = groups.add(np.where(kept, score, 0.0)) * over
    wide_weight = np.where(kept, wide_slope, 0.0)
    wide = groups.add(np.where(kept, wide_score, 0.0)) / np.maximum(groups.add(wide_weight), TINY)
    glow = wide - shift
    split = _Split(groups, blocks)
    near, far = split.means(score, weight), split.means(wide_score, wide_weight)
    blend = split.blend(near, far)
    seen_px = (1.0 - clipped) * _mottle_shift(groups, profiles.room(seen), score, kept) * over
    mottle_px = MOTTLE_PER_PX * sigma_px**2
    seen_px /= 1.0 + (seen_px / (LARGEST_MOTTLE * mottle_px)) ** 4
    left_px = max(UNSEEN_MOTTLE * mottle_px, mottle_px - float(np.sqrt(np.mean(seen_px**2))))
    variance = (
        split.variance(near + blend * (far - near))
        + (ASYMMETRY_SHARE * glow) ** 2
        + (CLIPPED_SHARE * sigma_px * clipped) ** 2
        + FINE_MOTTLE * left_px**2
    )
    good = (count >= LEAST_ROWS * spacing_px) & (variance < LARGEST_DEVIATION_PX**2)
    lit = total > 0.0
    usual = median(glow[lit]) if lit.any() else 0.0  # common to the line, as light from inside the skin is
    shift = shift + blend * np.where(lit, glow - usual, 0.0)
    x = groups.add(weight * centre) * over + shift - seen_px
    y = groups.add(weight * course.row) * over
    lit_branches = groups.branch[good]
    for branch in lit_branches[mark_changes(lit_branches)]:
        own = good & (groups.branch == branch)
        x[own], variance[own] = smooth_course(y[own], x[own], variance[own])
    deviation = np.sqrt(variance + (1.0 - FINE_MOTTLE) * left_px**2)
    none = np.zeros(len(x))
    return LineImage(
        centres_px=np.column_stack([x, y])[good],
        deviation_px=np.column_stack([deviation, none])[good],
        branch=groups.branch[good],
        width_px=np.full(int(good.sum()), sigma_px),
        grey=(total / np.maximum(count, 1.0) / GAUSSIAN_SLOPE)[good],
        clipped=clipped[good],
        glow_px=np.column_stack([glow, none])[good],
    )


def _mottle_shift(groups: _Groups, room: tuple[Array, Array, Array], score: Array, kept: Mask) -> Array:
    """Return what mottle adds to the score of each group, as the room's light shows the same skin."""
    room_score, room_light, light = (groups.add(np.where(kept, each, 0.0)) for each in room)
    mean = room_light / np.maximum(light, TINY)
    return np.asarray(room_score / np.maximum(mean, TINY) - groups.add(np.where(kept, score, 0.0)))


class _Groups:
    """Groups of successive rows of a branch."""

    def __init__(self, ridges: Ridges, rows: int) -> None:
        first = np.flatnonzero(mark_changes(ridges.branch))
        start = np.repeat(ridges.row[first], np.diff(first, append=len(ridges.row)))
        key = ridges.branch * (int(ridges.row.max()) + 1) + (ridges.row - start) // rows
        is_first = mark_changes(key)
        begins, self.of_row = np.flatnonzero(is_first), np.cumsum(is_first) - 1
        self.branch = ridges.branch[begins]
        self._branch_of_row, self._row = ridges.branch, ridges.row.astype(float)

    def add(self, values: NDArray[np.float64] | Mask) -> Array:
        """Return the sum over each group."""
        return np.asarray(np.bincount(self.of_row, values, len(self.branch)), dtype=float)

    def mean(self, values: Array, kept: Mask) -> Array:
        """Return the mean of the kept rows of each group, zero without any."""
        return self.add(np.where(kept, values, 0.0)) / np.maximum(self.add(kept), 1.0)

    def smooth(self, centre: Array, score: Array, slope: Array, kept: Mask) -> Array:
        """Return the centre in each row on straight pieces between the means of the groups."""
        weight = np.where(kept, slope, 0.0)
        total = self.add(weight)
        over = 1.0 / np.maximum(total, TINY)
        x = self.add(weight * centre + np.where(kept, score, 0.0)) * over
        y = self.add(weight * self._row) * over
        course = centre.copy()
        for branch in self.branch[mark_changes(self.branch)]:
            own, rows = (self.branch == branch) & (total > 0.0), self._branch_of_row == branch
            if own.sum() > 1:
                course[rows] = _interpolate(self._row[rows], y[own], x[own])
        limit = np.abs(course - centre) < LARGEST_STEP_PX
        return np.where(limit, course, centre)


def _interpolate(at: Array, known: Array, values: Array) -> Array:
    """Interpolate linearly, and beyond the ends with the slope of the last piece."""
    slopes = np.diff(values) / np.diff(known)
    piece = np.clip(np.searchsorted(known, at) - 1, 0, len(slopes) - 1)
    return np.asarray(values[piece] + slopes[piece] * (at - known[piece]))


def _mark_lit(score: Array, slope: Array, *, about_course: bool) -> Mask:
    """Mark the rows that show the line, and those only that show it on the course of their neighbours."""
    positive = slope[slope > 0.0]
    lit = slope > LEAST_LIGHT * (median(positive) if len(positive) else 0.0)
    if not (about_course and lit.any()):
        return np.asarray(lit)
    shift = np.abs(score / np.where(lit, slope, 1.0))
    scale = MAD_TO_SIGMA * median(shift[lit])
    return np.asarray(lit & (shift < max(OUTLIER_SIGMAS * scale, OUTLIER_FLOOR_PX)))


class _Split:
    """Groups split into blocks of rows, by whose scatter a group's centre is judged."""

    def __init__(self, groups: _Groups, blocks: _Groups) -> None:
        self._blocks, self._count = blocks, len(groups.branch)
        self._owner = np.zeros(len(blocks.branch), np.int64)
        self._owner[blocks.of_row] = groups.of_row

    def means(self, score: Array, weight: Array) -> Array:
        """Return what each block is off by, about the mean of its group's; NaN for one without light."""
        sums = self._blocks.add(weight)
        shift = self._blocks.add(np.where(weight > 0.0, score, 0.0)) / np.where(sums > 0.0, sums, np.nan)
        used = np.isfinite(shift)
        of_group = self._sum(np.where(used, shift, 0.0)) / np.maximum(self._sum(used), 1)
        return np.asarray(shift - of_group[self._owner])

    def blend(self, near: Array, far: Array) -> float:
        """Return the share of a second filter with which the blocks of all groups scatter least."""
        apart = far - near
        used = np.isfinite(apart)
        square = float((apart[used] ** 2).sum())
        return float(np.clip(-(near[used] * apart[used]).sum() / max(square, TINY), 0.0, LARGEST_BLEND))

    def variance(self, off: Array) -> Array:
        """Return the variance of each group's centre, from its blocks and its neighbours'."""
        used = np.isfinite(off)
        count = self._sum(used)
        square = self._sum(np.where(used, off, 0.0) ** 2)
        pooled = _sum_around(square) / np.maximum(_sum_around(np.maximum(count - 1.0, 0.0)), 1.0)
        return np.asarray(pooled / np.maximum(count, 1.0))

    def _sum(self, values: NDArray[np.float64] | Mask) -> Array:
        return np.asarray(np.bincount(self._owner, values, self._count), dtype=float)


def _sum_around(values: Array) -> Array:
    """Return the sum of each value (n,) with its neighbours, however few there are."""
    half = POOLED // 2
    return np.asarray(np.convolve(values, np.ones(POOLED), "full")[half : half + len(values)])
