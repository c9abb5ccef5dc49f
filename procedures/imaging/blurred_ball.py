"""Second estimator of a sphere's centre: a blurred ball fitted to the voxels themselves.

Near the surface of a ball of radius R, blurred by a Gaussian of covariance S = diag(sz², sxy², sxy²),

    I(x) = out + g·(x - x₀) + (in - out) / 2 · erfc( (r + t / 2r - R) / (√2 s) ),   r = |x - c|,
    s² = nᵀ S n along the radial direction n,   t = trace(S) - s²  (the curvature of the surface).

Unknown are the centre c, both intensities, both blurs, R, and the slope g that streaks of metal lay across
the neighbourhood. Voxels near metal are left out and outliers (post, skin) are weighed down by Cauchy
weights; Gauss-Newton with a damping that adapts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from scipy.special import erfc

from procedures.imaging.noise_covariance import covariance_of_centre
from procedures.imaging.region import Region

Array = NDArray[np.float64]

METAL_HU = 900.0
METAL_REACH_MM = 2.2  # blur of metal is felt this far
FIT_MARGIN_MM = 2.25  # voxels up to this far outside the sphere take part
HIDDEN_DEPTH_MM = 1.5  # under a hidden surface; deeper the blur brings nothing of it
HIDDEN_REACH = 0.14  # rad, a ray stands for its surroundings; neighbours are 0.18 apart
START_BLUR_MM = 0.42  # sigma of a usual reconstruction kernel
BLUR_LIMITS_MM = (0.15, 2.0)
MIN_VOXELS = 200
STEPS = 25
DONE_MM = 1e-5
CAUCHY = 2.385  # 95 % efficiency on Gaussian noise
MAD_TO_SIGMA = 1.4826
MIN_NOISE_HU = 0.5  # rounding to whole HU alone gives 0.3
START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-7, 1e6

# order of the unknowns
_OUT, _IN, _SZ, _SXY, _RADIUS = 3, 4, 5, 6, 7
_SLOPE = slice(8, 11)
_COUNT = 11


@dataclass(frozen=True, eq=False)
class BlurredBall:
    """A fitted ball. Centre and covariance in grid mm (slice, row, column), intensities in HU."""

    centre_mm: Array
    covariance_mm2: Array
    radius_mm: float
    noise_hu: float
    blur_mm: tuple[float, float]  # sigma across slices, in the plane
    metal_share: float  # of the sphere's surface, too near metal to be used
    slope_hu_per_mm: Array  # (3,) of the neighbourhood: what streaks of metal lay across it
    contrast_hu: float


def fit_blurred_ball(
    region: Region,
    start_mm: Array,
    radius_mm: float,
    inside_hu: float,
    outside_hu: float,
    *,
    hidden_ways: Array | None = None,
) -> BlurredBall | None:
    """Fit from a centre within about 0.3 mm; None when too few voxels are usable or nothing converges.

    `hidden_ways` (n, 3): directions from the centre in which the surface borders on something else than the
    outside; voxels near and beyond the surface there are left out.
    """
    z, y, x = region.axes_mm()
    distance = np.sqrt((z - start_mm[0]) ** 2 + (y - start_mm[1]) ** 2 + (x - start_mm[2]) ** 2)
    clean = _far_from_metal(region)
    usable = (distance < radius_mm + FIT_MARGIN_MM) & clean & np.isfinite(region.values)
    if hidden_ways is not None and len(hidden_ways) > 0:
        usable &= ~_hidden(region, start_mm, hidden_ways, distance > radius_mm - HIDDEN_DEPTH_MM)
    if usable.sum() < MIN_VOXELS:
        return None
    at_surface = np.abs(distance - radius_mm) < np.max(region.spacing_mm)
    metal_share = 1.0 - float(clean[at_surface].mean()) if at_surface.any() else 0.0
    where = np.argwhere(usable)
    points_mm = (where + region.start) * region.spacing_mm
    middle_mm = points_mm.mean(axis=0)
    values = region.values[usable]
    slab_mm = float(np.hypot(START_BLUR_MM, region.spacing_mm[0] / np.sqrt(12.0)))
    start = np.array([*start_mm, outside_hu, inside_hu, slab_mm, START_BLUR_MM, radius_mm, 0.0, 0.0, 0.0])
    solved = _minimise(points_mm, values, start, middle_mm)
    if solved is None or np.linalg.norm(solved[:3] - start_mm) > 0.5 * radius_mm:
        return None
    modelled, jacobian = _model(points_mm, solved, middle_mm)
    residuals = values - modelled
    noise_hu = _scale(residuals)
    weights = _weights(residuals, noise_hu)
    covariance_mm2 = covariance_of_centre(where, jacobian, residuals, weights, region.spacing_mm)
    return BlurredBall(
        centre_mm=solved[:3],
        covariance_mm2=covariance_mm2,
        radius_mm=float(solved[_RADIUS]),
        noise_hu=noise_hu,
        blur_mm=(float(solved[_SZ]), float(solved[_SXY])),
        metal_share=metal_share,
        slope_hu_per_mm=solved[_SLOPE],
        contrast_hu=float(solved[_IN] - solved[_OUT]),
    )


def _far_from_metal(region: Region) -> NDArray[np.bool_]:
    metal = region.values > METAL_HU  # NaN compares false
    if not metal.any():
        return np.ones(metal.shape, dtype=bool)
    return np.asarray(distance_transform_edt(~metal, sampling=region.spacing_mm) > METAL_REACH_MM)


def _hidden(region: Region, centre_mm: Array, ways: Array, outer: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Outer voxels that lie in one of these directions."""
    where = np.argwhere(outer)
    offsets = (where + region.start) * region.spacing_mm - centre_mm
    offsets /= np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-6)
    distance, _ = cKDTree(ways).query(offsets, distance_upper_bound=HIDDEN_REACH)
    hidden = np.zeros(outer.shape, dtype=bool)
    hidden[tuple(where[np.isfinite(distance)].T)] = True
    return hidden


def _model(points_mm: Array, unknowns: Array, middle_mm: Array) -> tuple[Array, Array]:
    """Intensities (n,) and their derivatives (n, 11) by the unknowns; the slope turns about `middle_mm`."""
    offsets = points_mm - unknowns[:3]
    r = np.maximum(np.linalg.norm(offsets, axis=1), 1e-6)
    n = offsets / r[:, None]
    variance_z, variance_xy = unknowns[_SZ] ** 2, unknowns[_SXY] ** 2
    along_z = n[:, 0] ** 2
    s2 = variance_xy + (variance_z - variance_xy) * along_z
    s = np.sqrt(s2)
    bend = (variance_z + 2 * variance_xy - s2) / (2 * np.maximum(r, unknowns[_SXY]))
    u = (r + bend - unknowns[_RADIUS]) / (np.sqrt(2.0) * s)
    cover = 0.5 * erfc(u)
    contrast = unknowns[_IN] - unknowns[_OUT]
    slope = contrast * np.exp(-(u**2)) / (np.sqrt(2.0 * np.pi) * s)  # -dI/dr
    jacobian = np.empty((len(r), _COUNT))
    jacobian[:, :3] = (slope * (1.0 - bend / r))[:, None] * n
    jacobian[:, _OUT] = 1.0 - cover
    jacobian[:, _IN] = cover
    # through u = d / (√2 s): du/ds = -u / s, with ds/dsz = sz n_z² / s and ds/dsxy = sxy (1 - n_z²) / s
    by_s = slope * np.sqrt(2.0) * u
    jacobian[:, _SZ] = by_s * unknowns[_SZ] * along_z / s
    jacobian[:, _SXY] = by_s * unknowns[_SXY] * (1.0 - along_z) / s
    jacobian[:, _RADIUS] = slope
    jacobian[:, _SLOPE] = points_mm - middle_mm
    return unknowns[_OUT] + contrast * cover + jacobian[:, _SLOPE] @ unknowns[_SLOPE], jacobian


def _minimise(points_mm: Array, values: Array, start: Array, middle_mm: Array) -> Array | None:
    unknowns = start
    damping = START_DAMPING
    modelled, jacobian = _model(points_mm, unknowns, middle_mm)
    residuals = values - modelled
    for _ in range(STEPS):
        scale = _scale(residuals)
        weights = _weights(residuals, scale)
        weighted = weights[:, None] * jacobian
        normal = jacobian.T @ weighted
        gradient = weighted.T @ residuals
        cost = _cost(residuals, scale)
        while damping < MOST_DAMPING:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
            trial = unknowns + step
            trial[[_SZ, _SXY]] = np.clip(trial[[_SZ, _SXY]], *BLUR_LIMITS_MM)
            modelled, trial_jacobian = _model(points_mm, trial, middle_mm)
            trial_residuals = values - modelled
            if _cost(trial_residuals, scale) <= cost:
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
    return unknowns if moved_mm < 100 * DONE_MM else None


def _scale(residuals: Array) -> float:
    return max(MAD_TO_SIGMA * float(np.median(np.abs(residuals))), MIN_NOISE_HU)


def _weights(residuals: Array, scale: float) -> Array:
    return np.asarray(1.0 / (1.0 + (residuals / (CAUCHY * scale)) ** 2))


def _cost(residuals: Array, scale: float) -> float:
    return float(np.log1p((residuals / (CAUCHY * scale)) ** 2).sum())
