"""Ball fit under strong streaks, jointly with a random streak field in each slice.

Two things defeat other fits of a ball under streaks. A band across it bends more than a polynomial can
follow; here each slice has its own field, whose size is estimated from the image (empirical Bayes). And dark
streaks in air stop at the lowest value that a scanner stores: there the image is no longer the sum of ball
and streak. Such voxels only say that the sum is no brighter than that (censored regression, Tobin 1958).

A streak is confined to the slices of its metal, so neighbouring slices say nothing about it. Within a slice
it is a Gaussian process, slow compared with the ball's edge and thus hardly confused with it, written as a
sum of cosines with a few coefficients per slice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from procedures.imaging.sphere_centre.ball_model import (
    BLUR_LIMITS_MM,
    MIN_VOXELS,
    OUT,
    RADIUS,
    SXY,
    SZ,
    TERMS,
    Stretch,
    add_stretch_derivatives,
    flat_weights,
    guess_ball,
    intensities,
    mark_directions,
    mark_metal_slices,
    scale,
    select_ball_voxels,
)
from procedures.imaging.sphere_centre.radial_edge import RadialEdge, ray_directions
from procedures.imaging.volume import Region
from ronna_hw.arrays import Array, Mask

# chosen on straight bands with standard deviations of 1.2 to 3 mm across `plain`: anything shorter follows
# the edge, which doubled the error; a ball's edge is 0.5 mm wide
LENGTH_MM = 3.0
HIGHEST = 0.2  # cycles per mm: above this, such a process has a thousandth of its power
NOISE_BAND = (0.1, 0.3)  # cycles per mm: the band used to estimate the noise, in which the edge is blurred
FEWEST_VOXELS = 40  # of a slice, to estimate its noise
CLEAR_SHARE = 0.05  # of the largest eigenvalue: patterns that the voxels see less of are dropped
ROOM_MM = 2.0  # from the voxels to the end of the cosines' period

STEPS, LEAST_STEPS = 14, 5
DONE_MM, SETTLED_MM = 5e-4, 5e-3
MOST_STEP_MM = 0.3
MOST_RESIZED = 0.3  # of the radius
FARTHEST_MM = 0.6  # from the start: streaks move the edges found by rays by less
START_NOISE_HU, START_FIELD_HU = 30.0, 150.0
FIELD_LIMITS_HU = (1.0, 1600.0)
AWAY_MM = 1.3  # from the edge, where its blur ends
EVIDENT = 0.75  # standard deviations of the noise: without streaks their field explains up to 0.4
MOST_ODD = 0.008  # share of voxels that fit neither ball nor field: 0.0024 under bands, 0.012 in hollow balls
MOST_SHADOWED = 0.12  # the same, with the narrow shadows in slices that metal passes through
QUIET_VOXELS = 100  # of a slice, to tell whether it is quiet
LEAST_NOISE_HU = 1.0
NOISE_PRIOR = 4.0  # modes by which a slice is drawn to the mean; a slice through a ball has 60
NOISE_FROM_STEP = 2  # in the first steps, residuals still contain the ball itself
FLOOR_SHARE = 0.005  # share of voxels at the lowest value: noise alone leaves one or two there
# Not in the model: neighbouring slices share streaks. What the fields add to the covariance counts twice, the
# likeliest for 59 spheres of `screws`, `bands` and `posts` (chi² / 3n 0.8, 1.2 and 1.2).
SHARED = 2.0
NO_FIELD_HU2 = 0.01
NOISE_FACTOR = 1.5  # in the weights: streaks narrower than their field are no noise
SLICES_OVERLAP = 1.2  # of the blur along the slices' normal: closer slices have noise in common
LEAST_CORRELATION = 0.1  # of the noise of two slices; the residuals of a fit hardly show less
STRETCH_FACTOR = 1.7  # of its variance, chosen on bands of 150 to 450 HU across `plain`
MOST_PULL = 30.0  # deviations; beyond this the normal tail is replaced by its limit


@dataclass(frozen=True, eq=False)
class StreakedBall:
    """Fitted ball. Centre and covariance in grid mm; `cleaned` is the region with streaks removed."""

    centre_mm: Array
    covariance_mm2: Array
    radius_mm: float
    metal_share: float  # part of the sphere's surface too close to metal to be used
    cleaned: Region
    stretch: Stretch
    is_evident: bool  # its streaks also show away from the sphere's edge


def fit_streaked_ball(region: Region, edge: RadialEdge) -> StreakedBall | None:
    """Fit a ball, starting from an edge sphere; return None if the fit fails or has too few voxels.

    Directions in which the edge is not on that sphere are excluded.
    """
    unseen = ray_directions()[~edge.seen]
    usable, metal_share = select_ball_voxels(region, edge.centre_mm, edge.radius_mm, unseen)
    if usable.sum() < MIN_VOXELS:
        return None
    points_mm = (np.argwhere(usable) + region.start) * region.spacing_mm
    values = region.values[usable]
    start = guess_ball(region, edge)
    floor_hu = _floor_hu(region)
    censored = np.zeros(len(values), dtype=bool) if floor_hu is None else values <= floor_hu
    field = SliceField.from_points(points_mm, float(np.ptp(points_mm[:, 1:], axis=0).max()) / 2.0)
    no_background = np.zeros((len(values), 0))
    unknowns, weights = start.copy(), np.ones(len(values))
    streaks = np.zeros(len(values))
    field_hu2 = np.full(len(field.slices), START_FIELD_HU**2)
    white_hu, noise_hu2 = START_NOISE_HU, np.full(len(field.slices), START_NOISE_HU**2)
    modes: tuple[NoiseModes, ...] = ()
    for number in range(STEPS):
        modelled, derivatives = intensities(points_mm, unknowns, no_background)
        working, known = _impute_censored(values, modelled + streaks, censored, floor_hu, white_hu)
        counted = weights * known
        result = _solve(field, counted, working - modelled, derivatives, field_hu2, NOISE_FACTOR * noise_hu2)
        if result is None:
            return None
        solved = result
        streaks, field_hu2 = solved.field, solved.field_hu2
        remaining = working - modelled - streaks
        white_hu2 = float(counted @ remaining**2) / max(float(counted.sum()) - solved.degrees, 1.0)
        white_hu = max(float(np.sqrt(white_hu2)), LEAST_NOISE_HU)
        noise_hu2 = np.full(len(field.slices), white_hu**2)
        if number >= NOISE_FROM_STEP:
            modes = modes or field.noise_modes((weights > 0.5) & ~censored)
            noise_hu2 = noise_powers(modes, remaining, white_hu**2, len(field.slices))
        weights = flat_weights(remaining, scale(remaining[~censored]))
        step = solved.step
        step[:3] = np.clip(step[:3], -MOST_STEP_MM, MOST_STEP_MM)
        unknowns = unknowns + step
        unknowns[[SZ, SXY]] = np.clip(unknowns[[SZ, SXY]], *BLUR_LIMITS_MM)
        moved_mm = float(np.abs(step[:3]).max())
        if not abs(unknowns[RADIUS] / start[RADIUS] - 1.0) < MOST_RESIZED:
            return None
        if number >= LEAST_STEPS and moved_mm < DONE_MM:
            break
    if moved_mm > SETTLED_MM or float(np.linalg.norm(unknowns[:3] - start[:3])) > FARTHEST_MM:
        return None
    near_metal = mark_metal_slices(region)[np.argwhere(usable)[:, 0]]
    is_free = np.array([not near_metal[one].any() for one in field.slices])
    odd = weights < 0.5
    if field_hu2[is_free].max(initial=0.0) >= FIELD_LIMITS_HU[1] ** 2:
        return None  # something else than streaks is in the image
    if float((odd & ~near_metal).mean()) > MOST_ODD or float(odd.mean()) > MOST_SHADOWED:
        return None
    modelled, derivatives = intensities(points_mm, unknowns, no_background)
    working, known = _impute_censored(values, modelled + streaks, censored, floor_hu, white_hu)
    stretched = add_stretch_derivatives(points_mm, unknowns, derivatives)
    # narrow streaks look like noise: that of the quietest slice is the scan's
    quiet_hu = min(
        [scale(remaining[one][known[one] > 0.99]) for one in field.slices if len(one) > QUIET_VOXELS],
        default=white_hu,
    )
    rest_hu, noise_hu = working - modelled, min(quiet_hu, white_hu)
    is_evident = any(
        _is_evident(points_mm, unknowns, unseen, one, rest_hu, streaks, noise_hu)
        for one in (known > 0.99, (known > 0.99) & near_metal & ~odd)
    )
    given = weights * known, rest_hu
    stretch_result = _solve(field, *given, stretched, field_hu2, STRETCH_FACTOR * NOISE_FACTOR * noise_hu2)
    by_noise, by_all = (
        _solve(field, *given, derivatives, one, noise_hu2)
        for one in (np.full_like(field_hu2, NO_FIELD_HU2), field_hu2)
    )
    if stretch_result is None or by_noise is None or by_all is None:
        return None
    covariance = by_noise.covariance + SHARED * (by_all.covariance - by_noise.covariance)
    voxel_index = np.argwhere(usable)
    shared_noise = _noise_shared_by_slices(
        voxel_index, np.where(odd | censored, np.nan, remaining), float(region.spacing_mm[0]), unknowns[SZ]
    )
    return StreakedBall(
        centre_mm=unknowns[:3],
        covariance_mm2=shared_noise * covariance[:3, :3],
        radius_mm=float(unknowns[RADIUS]),
        metal_share=metal_share,
        cleaned=_remove_streaks(
            region, field.fill_region(region, solved.coefficients), floor_hu, float(unknowns[OUT])
        ),
        is_evident=is_evident,
        stretch=Stretch(
            stretch_result.step[-TERMS:], stretch_result.covariance[-TERMS:, -TERMS:], float(unknowns[SZ])
        ),
    )


@dataclass(frozen=True, eq=False)
class Waves:
    """Cosine waves over a square of `side_mm` around `middle_mm` (row, column), with wave numbers (m, 2)."""

    middle_mm: Array
    side_mm: float
    numbers: NDArray[np.int64]

    @classmethod
    def from_band(cls, middle_mm: Array, side_mm: float, lowest: float, highest: float) -> Self:
        """Select all waves from `lowest` to `highest` cycles per mm."""
        count = int(2.0 * side_mm * highest) + 1
        numbers = np.array([(row, column) for row in range(count) for column in range(count)])
        cycles = np.hypot(*numbers.T) / (2.0 * side_mm)
        return cls(middle_mm, side_mm, numbers[(cycles >= lowest) & (cycles <= highest)])

    @property
    def cycles_per_mm(self) -> Array:
        """Spatial frequency (m,) of each wave."""
        return np.asarray(np.hypot(*self.numbers.T) / (2.0 * self.side_mm))

    def evaluate(self, rows_mm: Array, columns_mm: Array) -> Array:
        """Return the values (n, m) of the waves at positions (n,) in the slice."""
        row, column = self._cosines_along(rows_mm, 0), self._cosines_along(columns_mm, 1)
        return np.asarray(row[:, self.numbers[:, 0]] * column[:, self.numbers[:, 1]])

    def sum_over_grid(self, coefficients: Array, rows_mm: Array, columns_mm: Array) -> Array:
        """Return the sum of the waves over a grid (rows, columns); 0 outside the square."""
        table = np.zeros(self.numbers.max(axis=0) + 1)
        table[tuple(self.numbers.T)] = coefficients
        field = self._cosines_along(rows_mm, 0) @ table @ self._cosines_along(columns_mm, 1).T
        inside = [
            np.abs(places - middle) < 0.5 * self.side_mm
            for places, middle in zip((rows_mm, columns_mm), self.middle_mm, strict=True)
        ]
        return np.asarray(field * np.outer(*inside))

    def _cosines_along(self, places_mm: Array, axis: int) -> Array:
        share = (places_mm - self.middle_mm[axis]) / self.side_mm + 0.5
        return np.asarray(np.cos(np.pi * np.outer(share, np.arange(self.numbers[:, axis].max() + 1))))


@dataclass(frozen=True, eq=False)
class NoiseModes:
    """Noise patterns (k, m) over k voxels of slice `number`, indexed among all voxels by `rows` (k,)."""

    number: int
    rows: NDArray[np.intp]
    patterns: Array


def noise_powers(modes: tuple[NoiseModes, ...], residuals: Array, white_hu2: float, slices: int) -> Array:
    """Return the mean square of residuals (n,) along the modes of each slice, HU² per voxel.

    Metal makes some slices much noisier than others. A slice of few modes is drawn to the mean of all.
    """
    squares, counts = np.zeros(slices), np.zeros(slices)
    for one in modes:
        squares[one.number] = ((residuals[one.rows] @ one.patterns) ** 2).sum()
        counts[one.number] = one.patterns.shape[1]
    mean_hu2 = max(float(squares.sum() / max(counts.sum(), 1.0)), white_hu2)
    return np.asarray((squares + NOISE_PRIOR * mean_hu2) / (counts + NOISE_PRIOR))


@dataclass(frozen=True, eq=False)
class SliceField:
    """Streak field over a fit's voxels: the voxels of each slice, and the wave values (n, m) there.

    The variance of a coefficient is that of the slice's field.
    """

    waves: Waves
    scales: Array  # (m,) of a wave for a coefficient of 1
    slices: tuple[NDArray[np.intp], ...]
    heights_mm: Array
    terms: tuple[Array, ...]
    noise_terms: tuple[Array, ...]

    @classmethod
    def from_points(cls, points_mm: Array, radius_mm: float) -> Self:
        """Set up the field for voxels (n, 3) in grid mm within this radius of their centroid."""
        middle_mm = 0.5 * (points_mm.min(axis=0) + points_mm.max(axis=0))[1:]
        side_mm = 2.0 * (radius_mm + ROOM_MM)
        waves = Waves.from_band(middle_mm, side_mm, 0.0, HIGHEST)
        noisy = Waves.from_band(middle_mm, side_mm, *NOISE_BAND)
        power = np.exp(-2.0 * (np.pi * LENGTH_MM * waves.cycles_per_mm) ** 2)
        power *= np.prod(np.where(waves.numbers == 0, 1.0, 2.0), axis=1)  # the mean square of a cosine is 1/2
        scales = np.sqrt(power / power.sum())
        heights_mm = np.unique(points_mm[:, 0])
        slices = tuple(np.flatnonzero(points_mm[:, 0] == height) for height in heights_mm)
        places = [(points_mm[one, 1], points_mm[one, 2]) for one in slices]
        terms = tuple(waves.evaluate(*place) * scales for place in places)
        noise_terms = tuple(noisy.evaluate(*place) for place in places)
        return cls(waves, scales, slices, heights_mm, terms, noise_terms)

    def noise_modes(self, clear: Mask) -> tuple[NoiseModes, ...]:
        """Combine noise-band waves into modes that are orthonormal over a slice's clear voxels (n,)."""
        modes = []
        for number, (one, waves) in enumerate(zip(self.slices, self.noise_terms, strict=True)):
            seen = clear[one]
            if seen.sum() < FEWEST_VOXELS:
                continue
            values, vectors = np.linalg.eigh(waves[seen].T @ waves[seen])
            kept = values > CLEAR_SHARE * values[-1]
            patterns = waves[seen] @ (vectors[:, kept] / np.sqrt(values[kept]))
            modes.append(NoiseModes(number, one[seen], patterns))
        return tuple(modes)

    def fill_region(self, region: Region, coefficients: tuple[Array, ...]) -> Array:
        """Return the field over a region's voxels (slices, rows, columns); 0 where nothing was fitted."""
        z, y, x = region.axes_mm()
        field = np.zeros(region.values.shape)
        for height_mm, found in zip(self.heights_mm, coefficients, strict=True):
            number = int(np.argmin(np.abs(z.ravel() - height_mm)))
            field[number] = self.waves.sum_over_grid(found * self.scales, y.ravel(), x.ravel())
        return field


@dataclass(frozen=True, eq=False)
class _StepResult:
    """Result of one step: parameter update, covariance, and the field of each slice."""

    step: Array
    covariance: Array
    coefficients: tuple[Array, ...]
    field: Array  # (n,) HU
    field_hu2: Array  # (slices,)
    degrees: float  # degrees of freedom absorbed by the fields


def _is_evident(
    points_mm: Array,
    unknowns: Array,
    unseen: Array,
    known: Mask,
    remaining_hu: Array,
    streaks_hu: Array,
    noise_hu: float,
) -> bool:
    """Whether the streaks explain the residual image inside and outside the ball, away from its edge.

    A surface that is not where a ball's would be merely looks like a streak.
    """
    offsets_mm = points_mm - unknowns[:3]
    away = np.abs(np.linalg.norm(offsets_mm, axis=1) - unknowns[RADIUS]) > AWAY_MM
    away &= known & ~mark_directions(offsets_mm, unseen, away)
    if away.sum() < MIN_VOXELS:
        return False
    explained = float(np.mean(remaining_hu[away] ** 2 - (remaining_hu - streaks_hu)[away] ** 2))
    return explained > (EVIDENT * noise_hu) ** 2


def _noise_shared_by_slices(
    voxel_index: NDArray[np.int64], residuals: Array, slice_mm: float, blur_mm: float
) -> float:
    """Return the variance of a mean over slices, relative to slices of independent noise, at least 1.

    A cone-beam scan is reconstructed as a whole, so noise spans its thin slices as far as the blur does.
    Slices farther apart than their blur share streaks, but no noise. `residuals` (n,) of voxels at
    `voxel_index` (n, 3) are NaN where they are not noise.
    """
    if slice_mm > SLICES_OVERLAP * blur_mm:
        return 1.0
    low = voxel_index.min(axis=0)
    image = np.full(voxel_index.max(axis=0) - low + 1, np.nan)
    image[tuple((voxel_index - low).T)] = residuals
    variance = float(np.nanmean(image**2))
    shared = 1.0
    for lag in range(1, len(image)):
        correlation = float(np.nanmean(image[lag:] * image[:-lag])) / variance
        if not correlation > LEAST_CORRELATION:
            break
        shared += 2.0 * correlation
    return shared


def _floor_hu(region: Region) -> float | None:
    """Return the lowest stored value if the scanner clipped values there, or None if it did not."""
    known = region.values[np.isfinite(region.values)]
    lowest = float(known.min())
    return lowest if float((known == lowest).mean()) > FLOOR_SHARE else None


def _impute_censored(
    values: Array, expected: Array, censored: Mask, floor_hu: float | None, noise_hu: float
) -> tuple[Array, Array]:
    """Return values and weights (n,) that turn least squares into censored regression (Fisher scoring)."""
    working, known = values.copy(), np.ones(len(values))
    if floor_hu is None or not censored.any():
        return working, known
    below = np.clip((floor_hu + 0.5 - expected[censored]) / noise_hu, -MOST_PULL, MOST_PULL)
    hazard = np.exp(-0.5 * below**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(below))
    known[censored] = np.clip(hazard * (hazard + below), 1e-6, 1.0)
    working[censored] = expected[censored] - noise_hu / np.maximum(hazard + below, 1e-3)
    return working, known


def _solve(
    field: SliceField,
    weights: Array,
    residuals: Array,
    derivatives: Array,
    field_hu2: Array,
    noise_hu2: Array,
) -> _StepResult | None:
    """Solve generalized least squares with noise and a random field in each slice (Woodbury identity).

    None if the voxels leave a parameter open, as when the ball has moved beyond them.
    """
    unknowns = derivatives.shape[1]
    normal, pull = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    found, sizes_hu2 = [], np.empty(len(field.slices))
    streaks, degrees = np.empty(len(residuals)), 0.0
    slices = zip(field.slices, field.terms, field_hu2.tolist(), noise_hu2.tolist(), strict=True)
    for number, (one, terms, size_hu2, noisy_hu2) in enumerate(slices):
        root = np.sqrt(weights[one])
        weighted, weighted_derivatives = terms * root[:, None], derivatives[one] * root[:, None]
        remaining = residuals[one] * root
        count = weighted.shape[1]
        spread = np.linalg.inv(weighted.T @ weighted / noisy_hu2 + np.eye(count) / size_hu2)
        whitened = (
            weighted_derivatives / noisy_hu2
            - weighted @ (spread @ (weighted.T @ weighted_derivatives)) / noisy_hu2**2
        )
        normal += weighted_derivatives.T @ whitened
        pull += whitened.T @ remaining
        coefficients = spread @ (weighted.T @ remaining) / noisy_hu2
        used_degrees = count - float(np.trace(spread)) / size_hu2
        streaks[one] = terms @ coefficients
        found.append(coefficients)
        sizes_hu2[number] = float(coefficients @ coefficients) / max(used_degrees, 1e-9)
        degrees += used_degrees
    low, high = FIELD_LIMITS_HU
    try:
        covariance = np.asarray(np.linalg.inv(normal + 1e-9 * np.diag(np.diag(normal))), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(covariance).all():
        return None
    sizes_hu2 = np.clip(sizes_hu2, low**2, high**2)
    return _StepResult(covariance @ pull, covariance, tuple(found), streaks, sizes_hu2, degrees)


def _remove_streaks(region: Region, streaks: Array, floor_hu: float | None, outside_hu: float) -> Region:
    """Subtract the streaks; set voxels at the scanner's floor to the level of the surroundings."""
    values = region.values - streaks
    if floor_hu is not None:
        values[region.values <= floor_hu] = outside_hu
    return replace(region, values=values)
