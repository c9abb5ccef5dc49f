"""Model of a scanned ball on an uneven background, its stretch, and a robust fit to selected voxels.

Near the surface of a ball of radius R, blurred by a Gaussian of covariance S = diag(sz², sxy², sxy²),

    I(x) = out + b(x) + (in - out) / 2 · erfc( (r + t / 2r - R) / (√2 s) ),   r = |x - c|,
    s² = nᵀ S n along the radial direction n,   t = trace(S) - s²  (the curvature of the surface),

with a polynomial b that represents metal streaks across the neighbourhood.

A stretched body has its surface at R + q(n) along each direction n, with q of second degree and zero mean: an
ellipsoid to first order. Stretch is the main difference between a short rod with round ends and a ball.
Fitted together with ball and background, it is known to a few hundredths of a millimetre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt
from scipy.spatial import cKDTree
from scipy.special import erfc

from procedures.imaging.sphere_centre.radial_edge import RadialEdge
from procedures.imaging.volume import Region
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import CAUCHY, cauchy_weights, robust_sigma

# order of the parameters: the centre (slice, row, column), then these, then the background coefficients
OUT, IN, SZ, SXY, RADIUS = 3, 4, 5, 6, 7
BALL = 8
SLOPE = slice(BALL, BALL + 3)

TERMS = 5

Model = Callable[[Array], tuple[Array, Array]]  # parameters (m,) to values (n,) and derivatives (n, m)

STEPS = 25
DONE_MM = 5e-5
FLAT_TO = 6.0  # standard deviations, at which the weight is a half
MIN_NOISE_HU = 0.5  # rounding to whole HU alone causes 0.3
MIN_GROWTH = 0.1
START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-7, 1e6
BLOCK = 512  # rows; for larger products BLAS starts threads that cost more than they save

BLUR_LIMITS_MM = (0.15, 2.0)
MIN_VOXELS = 200
SHAPE_STEPS = 3
CORRELATED = 5.0  # variance relative to that of independent voxels: noise is correlated over a few
OUTLIER = 5.0  # deviations: noise alone reaches this in one sphere of a hundred
OUTLIER_REACH_MM = 1.2  # and at least a voxel: reach of another object's blur
FITTED_DEGREES = (1, 2, 3)
METAL_HU = 900.0
METAL_REACH_MM = 2.2  # reach of blur from metal
STREAKING_HU = 2000.0  # denser than a skull
SLICE_REACH_MM = 1.5  # along the slices: the cone of the beam takes streaks that far
FIT_MARGIN_MM = 2.25  # voxels up to this far outside the sphere are used
HIDDEN_DEPTH_MM = 1.5  # under a hidden surface; its blur does not reach deeper
HIDDEN_REACH = 0.14  # rad; a ray represents its surroundings, neighbours are 0.18 apart
START_BLUR_MM = 0.42  # sigma of a typical reconstruction kernel


def polynomial(places: Array, degrees: Iterable[int]) -> Array:
    """Return all monomials (n, m) of the given degrees in the coordinates of `places` (n, 3)."""
    chosen = [one for degree in degrees for one in combinations_with_replacement(range(3), degree)]
    columns = np.empty((len(places), len(chosen)))
    for number, axes in enumerate(chosen):
        columns[:, number] = places[:, axes[0]]
        for axis in axes[1:]:
            columns[:, number] *= places[:, axis]
    return columns


def intensities(points_mm: Array, unknowns: Array, background: Array) -> tuple[Array, Array]:
    """Return intensities (n,) HU at points (n, 3) grid mm, and their parameter derivatives (n, 8 + m).

    `background` (n, m) are the polynomial's terms at the points. The derivatives neglect that the blur varies
    with the direction from the centre and shifts the edge: both effects are small, and fits converge without
    them.
    """
    offsets = points_mm - unknowns[:3]
    r = np.maximum(np.linalg.norm(offsets, axis=1), 1e-6)
    n = offsets / r[:, None]
    variance_z, variance_xy = unknowns[SZ] ** 2, unknowns[SXY] ** 2
    along_z = n[:, 0] ** 2
    s2 = variance_xy + (variance_z - variance_xy) * along_z
    s = np.sqrt(s2)
    bend = (variance_z + 2 * variance_xy - s2) / (2 * np.maximum(r, unknowns[SXY]))
    u = (r + bend - unknowns[RADIUS]) / (np.sqrt(2.0) * s)
    cover = 0.5 * erfc(u)
    contrast = unknowns[IN] - unknowns[OUT]
    fall = contrast * np.exp(-(u**2)) / (np.sqrt(2.0 * np.pi) * s)  # -dI/dr
    derivatives = np.empty((len(r), len(unknowns)))
    derivatives[:, :3] = (fall * (1.0 - bend / r))[:, None] * n
    derivatives[:, OUT] = 1.0 - cover
    derivatives[:, IN] = cover
    # through u = d / (√2 s): du/ds = -u / s, with ds/dsz = sz n_z² / s and ds/dsxy = sxy (1 - n_z²) / s
    by_s = fall * np.sqrt(2.0) * u
    derivatives[:, SZ] = by_s * unknowns[SZ] * along_z / s
    derivatives[:, SXY] = by_s * unknowns[SXY] * (1.0 - along_z) / s
    derivatives[:, RADIUS] = fall
    derivatives[:, BALL:] = background
    return unknowns[OUT] + contrast * cover + background @ unknowns[BALL:], derivatives


@dataclass(frozen=True, eq=False)
class Stretch:
    """Deviation of a surface from a ball, as the sum of `stretch_terms` along slice, row and column.

    `coefficients_mm` (5,) are those of the terms, with their covariance (5, 5); `slice_blur_mm` is the fitted
    blur along the slices.
    """

    coefficients_mm: Array
    covariance_mm2: Array
    slice_blur_mm: float

    @property
    def deviation_mm(self) -> float:
        """Standard deviation of a term, averaged over the five."""
        return float(np.sqrt(float(np.trace(self.covariance_mm2)) / TERMS))

    @property
    def difference_mm(self) -> float:
        """Longest minus shortest semi-axis."""
        return float(np.ptp(np.linalg.eigvalsh(stretch_matrix(self.coefficients_mm))))


def add_stretch_derivatives(points_mm: Array, unknowns: Array, derivatives: Array) -> Array:
    """Append derivatives by the five stretch terms to a ball's derivatives (n, m), giving (n, m + 5)."""
    directions = points_mm - unknowns[:3]
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-6)
    return np.column_stack((derivatives, derivatives[:, RADIUS, None] * stretch_terms(directions)))


def stretch_terms(directions: Array) -> Array:
    """Return the five stretch terms (n, 5) along unit directions (n, 3)."""
    x, y, z = directions.T
    return np.column_stack((x * x - z * z, y * y - z * z, x * y, x * z, y * z))


def stretch_matrix(terms: Array) -> Array:
    """Build the symmetric, traceless matrix (3, 3) from five stretch terms."""
    a, b, c, d, e = terms.tolist()
    return np.array([[a, c / 2, d / 2], [c / 2, b, e / 2], [d / 2, e / 2, -a - b]])


def minimise(model: Model, values: Array, start: Array, limits: Callable[[Array], Array]) -> Array | None:
    """Fit `values` (n,) by damped Gauss-Newton with Cauchy weights; return None if it does not converge.

    The first three parameters are a position in mm; `limits` keeps all of them in range.
    """
    unknowns = start
    damping = START_DAMPING
    modelled, jacobian = model(unknowns)
    residuals = values - modelled
    moved_mm = np.inf
    for _ in range(STEPS):
        noise = scale(residuals)
        weighted = cauchy_weights(residuals, noise)[:, None] * jacobian
        normal = products(jacobian, weighted)
        gradient = weighted.T @ residuals
        cost = _cost(residuals, noise)
        while damping < MOST_DAMPING:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
            trial = limits(unknowns + step)
            modelled, trial_jacobian = model(trial)
            trial_residuals = values - modelled
            if _cost(trial_residuals, noise) <= cost:
                break
            if np.abs(step[:3]).max() < DONE_MM:
                return unknowns
            damping *= 10.0
        else:
            return None
        moved_mm = float(np.abs(trial[:3] - unknowns[:3]).max())
        unknowns, jacobian, residuals = trial, trial_jacobian, trial_residuals
        damping = max(damping / 10.0, LEAST_DAMPING)
        if moved_mm < DONE_MM:
            return unknowns
    return unknowns if moved_mm < 20 * DONE_MM else None


def scale(residuals: Array) -> float:
    """Return the robust standard deviation of the residuals in HU, at least the minimum noise."""
    return max(robust_sigma(residuals), MIN_NOISE_HU)


def flat_weights(residuals: Array, noise: float) -> Array:
    """Return weights (n,): about 1 for residuals within the noise, almost 0 for outliers.

    Cauchy weights distort the noise itself, which raises the high end of its spectrum: half the gain from
    whitening would be lost.
    """
    return np.asarray(1.0 / (1.0 + (residuals / (FLAT_TO * noise)) ** 4))


def products(one: Array, other: Array) -> Array:
    """Compute `one`ᵀ `other` for (n, k) and (n, m) arrays in blocks of rows."""
    total = np.zeros((one.shape[1], other.shape[1]))
    for row in range(0, len(one), BLOCK):
        total += one[row : row + BLOCK].T @ other[row : row + BLOCK]
    return total


def _cost(residuals: Array, noise: float) -> float:
    return float(np.log1p((residuals / (CAUCHY * noise)) ** 2).sum())


@dataclass(frozen=True, eq=False)
class BallVoxels:
    """Voxels used in a fit: indices and grid mm (n, 3), HU (n,), background terms (n, m)."""

    voxel_index: NDArray[np.int64]
    points_mm: Array
    values: Array
    places: Array  # (n, 3) in radii from their centroid
    background: Array
    spacing_mm: Array
    farthest_mm: float  # from the start; farther away is another object
    covered: bool = False  # much of the surface borders on something else, whose traces may be anywhere

    @classmethod
    def of(cls, region: Region, usable: Mask, radius_mm: float, *, covered: bool = False) -> Self:
        """Collect a region's usable voxels around a ball of about this radius."""
        voxel_index = np.argwhere(usable)
        points_mm = (voxel_index + region.start) * region.spacing_mm
        places = (points_mm - points_mm.mean(axis=0)) / radius_mm
        background = polynomial(places, FITTED_DEGREES)
        values = region.values[usable]
        return cls(
            voxel_index, points_mm, values, places, background, region.spacing_mm, 0.5 * radius_mm, covered
        )

    def fit_robustly(self, ball: Array) -> Array | None:
        """Fit all parameters, starting from the ball's; return None without convergence near the start.

        A linear background comes first, since it converges from farther away, then the full polynomial.
        """
        sloping = np.zeros(SLOPE.stop)
        sloping[:BALL] = ball
        settled = self._find_minimum(sloping, ball)
        if settled is None:
            return None
        bent = np.zeros(BALL + self.background.shape[1])
        bent[: SLOPE.stop] = settled
        return self._find_minimum(bent, ball)

    def _find_minimum(self, start: Array, ball: Array) -> Array | None:
        background = self.background[:, : len(start) - BALL]
        settled = minimise(
            lambda unknowns: intensities(self.points_mm, unknowns, background), self.values, start, _clip_blur
        )
        if settled is None or np.linalg.norm(settled[:3] - ball[:3]) > self.farthest_mm:
            return None
        return settled

    def without_outliers(self, unknowns: Array) -> BallVoxels:
        """Drop outlying voxels, such as those of the ball's post and its blur."""
        modelled, _ = intensities(self.points_mm, unknowns, self.background)
        residuals = self.values - modelled
        outlying = np.abs(residuals) > OUTLIER * scale(residuals)
        if not outlying.any():
            return self
        scaled = self.points_mm / np.maximum(OUTLIER_REACH_MM, self.spacing_mm)
        distance, _ = cKDTree(scaled[outlying]).query(scaled, distance_upper_bound=1.0 + 1e-6)
        clear = ~np.isfinite(distance)
        if clear.sum() < MIN_VOXELS:
            return self
        by_voxel = ("voxel_index", "points_mm", "values", "places", "background")
        return replace(self, **{name: getattr(self, name)[clear] for name in by_voxel})

    def distance_outside_mm(self, unknowns: Array) -> Array:
        """Return the distance (n,) of each voxel from the ball's surface, positive outside."""
        return np.asarray(np.linalg.norm(self.points_mm - unknowns[:3], axis=1) - unknowns[RADIUS])

    def stretch(self, unknowns: Array, clear: Mask) -> Stretch:
        """Estimate a fitted ball's stretch from the voxels (n,) marked as clear of other objects."""
        places = self.points_mm[clear]
        modelled, derivatives = intensities(places, unknowns, self.background[clear])
        derivatives = add_stretch_derivatives(places, unknowns, derivatives)
        residuals = self.values[clear] - modelled
        remaining, weights = residuals, np.ones(len(residuals))
        for _ in range(SHAPE_STEPS):
            normal = products(derivatives, weights[:, None] * derivatives)
            answer = np.linalg.pinv(normal, hermitian=True)
            step = answer @ (derivatives.T @ (weights * residuals))
            remaining = residuals - derivatives @ step
            weights = flat_weights(remaining, scale(remaining))
        covariance = CORRELATED * scale(remaining) ** 2 * np.asarray(answer)
        return Stretch(step[-TERMS:], covariance[-TERMS:, -TERMS:], float(unknowns[SZ]))

    def evaluate(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """Return derivatives (n, m), weighted residuals w·r (n,) and weights (n,) at these parameters."""
        modelled, derivatives = intensities(self.points_mm, unknowns, self.background)
        residuals = self.values - modelled
        weights = (cauchy_weights if self.covered else flat_weights)(residuals, scale(residuals))
        return derivatives, weights * residuals, weights

    def growth(self, weights: Array) -> float:
        """Return the mean derivative of w·r by r, relative to the mean weight; it never vanishes."""
        by_residual = 2.0 * weights**2 - weights if self.covered else 4.0 * weights**2 - 3.0 * weights
        return max(float(np.mean(by_residual)), MIN_GROWTH) / float(np.mean(weights))


def _clip_blur(unknowns: Array) -> Array:
    unknowns[[SZ, SXY]] = np.clip(unknowns[[SZ, SXY]], *BLUR_LIMITS_MM)
    return unknowns


def select_ball_voxels(
    region: Region, centre_mm: Array, radius_mm: float, hidden_directions: Array | None
) -> tuple[Mask, float]:
    """Mark the voxels around a ball that are clear of metal and of hidden directions (n, 3).

    Also returns the part of the ball's surface that is too close to metal.
    """
    z, y, x = region.axes_mm()
    distance = np.sqrt((z - centre_mm[0]) ** 2 + (y - centre_mm[1]) ** 2 + (x - centre_mm[2]) ** 2)
    clean = _mark_far_from_metal(region)
    usable = (distance < radius_mm + FIT_MARGIN_MM) & clean & np.isfinite(region.values)
    if hidden_directions is not None and len(hidden_directions) > 0:
        offsets = (np.argwhere(usable) + region.start) * region.spacing_mm - centre_mm
        outer = distance[usable] > radius_mm - HIDDEN_DEPTH_MM
        usable[usable] = ~mark_directions(offsets, hidden_directions, outer)
    at_surface = np.abs(distance - radius_mm) < np.max(region.spacing_mm)
    metal_share = 1.0 - float(clean[at_surface].mean()) if at_surface.any() else 0.0
    return usable, metal_share


def guess_ball(region: Region, edge: RadialEdge) -> Array:
    """Return start values for a ball's eight parameters, derived from its surface."""
    slab_mm = float(np.hypot(START_BLUR_MM, region.spacing_mm[0] / np.sqrt(12.0)))
    levels_hu = edge.outside_hu, edge.inside_hu
    return np.array([*edge.centre_mm, *levels_hu, slab_mm, START_BLUR_MM, edge.radius_mm])


def _mark_far_from_metal(region: Region) -> Mask:
    metal = region.values > METAL_HU  # NaN compares false
    if not metal.any():
        return np.ones(metal.shape, dtype=bool)
    return np.asarray(distance_transform_edt(~metal, sampling=region.spacing_mm) > METAL_REACH_MM)


def mark_metal_slices(region: Region) -> Mask:
    """Mark the slices (n,) at or next to metal, which may hold its streaks."""
    metal = np.asarray((region.values > STREAKING_HU).any(axis=(1, 2)))
    reach = max(1, round(SLICE_REACH_MM / float(region.spacing_mm[0])))
    return np.asarray(binary_dilation(metal, iterations=reach)) if metal.any() else metal


def mark_directions(offsets_mm: Array, directions: Array, considered: Mask) -> Mask:
    """Mark the `considered` voxels, offset (n, 3) from the centre, that lie in one of these directions."""
    found = np.zeros(len(considered), dtype=bool)
    if len(directions) == 0:
        return found
    selected = offsets_mm[considered]
    selected /= np.maximum(np.linalg.norm(selected, axis=1, keepdims=True), 1e-6)
    distance, _ = cKDTree(directions).query(selected, distance_upper_bound=HIDDEN_REACH)
    found[considered] = np.isfinite(distance)
    return found
