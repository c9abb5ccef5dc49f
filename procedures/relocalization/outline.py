"""Outline of a disc in the full image: edges along rays, robust ellipse fit, and reliability check.

On each ray from the centre, a blurred step is fitted to the steepest fall in brightness: background plus a
sloping inside times the complementary error function. Then comes an ellipse. Rays whose edge is too weak, too
blurred, misfitted or off the ellipse are not rim: posts, occluders, stains and the image border cost rim, but
do not pull the centre. Where a stain dims the film up to the rim, the outline is still visible: such rays do
not support the ellipse, but those with an edge on it count as visible rim.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.special import ndtr

from procedures.relocalization.centre_covariance import RimLight, centre_covariance, clipped_shift_px
from procedures.relocalization.circle_search import Circle
from procedures.relocalization.ellipse import Ellipse, EllipseFit, circle_as_ellipse, fit_ellipse
from procedures.relocalization.grey_image import GreyImage
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import median

BLUR_FLOOR_PX = 0.5  # linear interpolation between pixels alone blurs about this much
STEP_ITERATIONS = 3  # with ten, a centre changes by less than 0.005 px
SHIFT_LIMIT_PX = 1.0  # per iteration
DAMPING = 1e-3
INVERSE_ROOT_TWO_PI = 1.0 / np.sqrt(2.0 * np.pi)

# Rim below a stain: the step from the dimmed film to the background, within a window too narrow for the
# stain's own edge to matter. Blood and liquid leave 0.2 to 0.4 of the light (U).
DIM_STEP_SHARE = 0.15
DIM_NOISE_FACTOR = 6.0  # steps from noise alone are smaller
DIM_SPAN_BLURS, DIM_SPAN_PX = 3.0, 2.0
DIM_OFF_RIM_PX = 0.7  # the stain's inner edge shifts the steepest point by about half a pixel

LEAST_RIM = 0.25  # with less it is no sphere at all
RELIABLE_RIM = 0.625  # of the rim in view; a loss of 38 % must never pass
CARRYING_RIM = 0.5  # of the rim must support the ellipse, not counting what a stain dims
RELIABLE_AXIS_RATIO = (
    0.99  # a sphere in a corner of the sensor has 0.996; below, two objects share an outline
)
SPHERE_AXIS_RATIO = 0.75
RELIABLE_SCATTER_PX = 0.6
RELIABLE_CONTRAST_TO_NOISE = 6.0
TOO_FAINT = "the sphere is too faint"
ONE_SIDED = "only one side of the sphere is lit or in view"
SATURATED_SIDE_OF_RIM = "one side of the rim is saturated"
ONE_SIDED_RATIO = 2.5  # brightest over darkest film at the rim; the head's own lamps light it evenly
RELIABLE_CLIPPED_SHIFT_PX = 0.1  # a pair is then uncertain by a quarter of the 10 um of a stained sphere
FULL_SCALE_8_BIT, FULL_SCALE_12_BIT = 255.0, 4095.0
FILLED_SHARE = 0.6  # of the inside that must be brighter than half of the step
FILLED_AREA = (0.02, 0.8)  # sampled range, as a share of the area from the centre
FILLED_RINGS, FILLED_RAYS = 12, 36

COARSE_RAYS = 180
FINE_RAYS = 300
COARSE_SPAN = 0.05  # of the radius, to either side of the first guess
COARSE_SPAN_PX = 3.0  # px of the reduced image, at least
FINE_SPAN_BLURS = 4.0
BLUR_ATTEMPTS = 3  # the first attempt on a defocused rim sees only the middle of the edge
BLUR_GROWTH = 1.5
FINE_SPAN_PX = 6.0  # beyond the blur: enough plateau for both grey levels

STEP_SHARE = 0.35  # of the median step: a smaller one is the sphere against its post, or a shadow
BLUR_RATIO = 2.5  # to either side of the median blur
MISFIT_SHARE = 0.25  # of the step
OFF_RIM_SIGMAS = 4.0
OFF_RIM_PX = 0.35  # never stricter than this: grain and small dents still count as rim
OFF_RIM_LIMIT_PX = 1.5


class SphereStatus(StrEnum):
    """Whether a sphere's centre may be used for a measurement."""

    OK = "OK"
    UNRELIABLE = "UNRELIABLE"


@dataclass(frozen=True)
class SphereImage:
    """Sphere in an image. (0, 0) is the centre of the top-left pixel; perspective bias is not removed.

    `axes_px` are semi-axes, major first. `quality` 0..1 falls with lost rim, scatter and noise.
    `covariance_px2` is that of the centre, x and y. `rim_fraction` is the visible share of the rim. `doubt`
    is the reason for UNRELIABLE.
    """

    centre_px: tuple[float, float]
    axes_px: tuple[float, float]
    quality: float
    status: SphereStatus
    covariance_px2: tuple[tuple[float, float], tuple[float, float]]
    rim_fraction: float
    scatter_px: float
    blur_px: float
    doubt: str = ""

    def with_offset(self, offset_x_px: float, offset_y_px: float) -> SphereImage:
        """Return the sphere in full-sensor pixels, given the offsets of the region of interest."""
        x, y = self.centre_px
        return replace(self, centre_px=(x + offset_x_px, y + offset_y_px))


def fit_outline(image: GreyImage, guess: Circle, factor: int) -> SphereImage | None:
    """Fit the ellipse at full resolution, starting from a guess. Return None if there is no disc."""
    span_px = max(COARSE_SPAN_PX * factor, COARSE_SPAN * guess.radius_px)
    start = circle_as_ellipse(guess.centre_px, guess.radius_px)
    coarse_profiles = sample_profiles(image, start, COARSE_RAYS, span_px)
    falls = steepest_falls(coarse_profiles)
    rim = falls.found & _mark_strong(falls)
    coarse = fit_ellipse(rim_points(start, coarse_profiles, falls.offset_px)[rim], start)
    if coarse is None or not _is_near(coarse.ellipse, guess, span_px):
        return None
    blur = median(falls.blur_px[rim])
    for _ in range(BLUR_ATTEMPTS):
        span_px = FINE_SPAN_BLURS * blur + FINE_SPAN_PX
        profiles = sample_profiles(image, coarse.ellipse, FINE_RAYS, span_px)
        edges = fit_blurred_steps(profiles, steepest_falls(profiles), blur)
        assumed, blur = blur, median(edges.blur_px)
        if blur < BLUR_GROWTH * assumed:
            break
    points = rim_points(coarse.ellipse, profiles, edges.offset_px)
    rim = _mark_plausible(edges)
    first = fit_ellipse(points[rim], coarse.ellipse, rough_start=False)
    if first is None:
        return None
    rim &= _mark_on_rim(first, points)
    inner = rim & np.roll(rim, 1) & np.roll(rim, -1)  # a ray next to a lost one is affected by the occluder
    fit = fit_ellipse(points[inner], first.ellipse, rough_start=False)
    if fit is None or not _is_near(fit.ellipse, guess, 2.0 * COARSE_SPAN_PX * factor + span_px):
        return None
    return judge_outline(image, fit, edges, _clipped_share(image, profiles, blur), rim, inner)


def judge_outline(
    image: GreyImage, fit: EllipseFit, edges: RimEdges, clipped: Array, bright: Mask, rim: Mask
) -> SphereImage | None:
    """Assess the outline. `rim` flags the rays that support it, `bright` also their neighbours."""
    step, noise, blur = (
        median(values[rim]) for values in (edges.step_grey, edges.misfit_grey, edges.blur_px)
    )
    major, minor = fit.ellipse.axes_px
    least_grey = max(DIM_STEP_SHARE * step, DIM_NOISE_FACTOR * noise)
    dim = _mark_dimmed(image, fit.ellipse, len(bright), blur, least_grey)
    rim_fraction, supporting = float(np.mean(bright | dim)), float(np.mean(bright))
    if rim_fraction < LEAST_RIM or minor / major < SPHERE_AXIS_RATIO:
        return None
    ray = np.flatnonzero(rim)
    light = RimLight(ray, len(rim), edges.dark_grey[ray], edges.step_grey[ray], clipped[ray], blur)
    everywhere = np.ones(len(bright), dtype=np.bool_)
    is_filled = _bright_share(image, fit.ellipse, light.half_way_grey, everywhere) >= FILLED_SHARE
    if not is_filled:
        at_rim = _bright_share(image, fit.ellipse, light.half_way_grey, bright | dim)
        if not at_rim >= FILLED_SHARE:
            return None
    contrast_to_noise = step / max(noise, 1e-6)
    lacks_rim = rim_fraction < RELIABLE_RIM or supporting < CARRYING_RIM
    clipped_px = np.linalg.norm(clipped_shift_px(fit, light))
    doubts = {
        ONE_SIDED: not is_filled or (lacks_rim and light.film_ratio > ONE_SIDED_RATIO),
        "too much of the rim is hidden": rim_fraction < RELIABLE_RIM,
        "too much of the rim is stained": supporting < CARRYING_RIM,
        "the outline is not round": minor / major < RELIABLE_AXIS_RATIO,
        "the rim is too rough": fit.sigma_px > RELIABLE_SCATTER_PX,
        TOO_FAINT: contrast_to_noise < RELIABLE_CONTRAST_TO_NOISE,
        SATURATED_SIDE_OF_RIM: clipped_px > RELIABLE_CLIPPED_SHIFT_PX,
    }
    doubt = next((words for words, applies in doubts.items() if applies), "")
    quality = rim_fraction / (1.0 + (fit.sigma_px / RELIABLE_SCATTER_PX) ** 2)
    quality /= 1.0 + (RELIABLE_CONTRAST_TO_NOISE / contrast_to_noise) ** 2
    (xx, xy), (yx, yy) = centre_covariance(fit, light).tolist()
    return SphereImage(
        centre_px=fit.ellipse.centre_px,
        axes_px=(major, minor),
        quality=min(1.0, max(0.0, quality)),
        status=SphereStatus.UNRELIABLE if doubt else SphereStatus.OK,
        covariance_px2=((xx, xy), (yx, yy)),
        rim_fraction=rim_fraction,
        scatter_px=fit.sigma_px,
        blur_px=blur,
        doubt=doubt,
    )


def _mark_dimmed(image: GreyImage, ellipse: Ellipse, rays: int, blur_px: float, least_grey: float) -> Mask:
    """Mark the rays (n,) with an edge on the ellipse itself, even where the reflective film is dim."""
    span_px = DIM_SPAN_BLURS * blur_px + DIM_SPAN_PX
    falls = steepest_falls(sample_profiles(image, ellipse, rays, span_px))
    on_rim = np.abs(falls.offset_px) < DIM_OFF_RIM_PX
    return np.asarray(falls.found & on_rim & (falls.step_grey > least_grey))


def _clipped_share(image: GreyImage, profiles: Profiles, blur_px: float) -> Array:
    """Return the share (rays,) of the film on each ray that is clipped at full scale."""
    full = FULL_SCALE_8_BIT if image.dtype == np.uint8 else FULL_SCALE_12_BIT
    return np.asarray((profiles.grey[:, profiles.offset_px < -blur_px] >= full).mean(axis=1))


def _bright_share(image: GreyImage, ellipse: Ellipse, level_grey: float, directions: Mask) -> float:
    """Return the fraction of the interior brighter than a level, in the marked of all directions (rays,)."""
    radius = np.sqrt(np.linspace(*FILLED_AREA, FILLED_RINGS))[:, None]  # equal area per sample
    marked = directions[np.arange(FILLED_RAYS) * len(directions) // FILLED_RAYS]
    angle: Array = np.flatnonzero(marked).astype(float) * (2.0 * np.pi / FILLED_RAYS)
    distance = radius * ellipse.radius_at(angle)
    x = np.rint(ellipse.centre_px[0] + distance * np.cos(angle)).astype(int)
    y = np.rint(ellipse.centre_px[1] + distance * np.sin(angle)).astype(int)
    in_image = (x >= 0) & (x < image.shape[1]) & (y >= 0) & (y < image.shape[0])
    if not in_image.any():
        return 0.0
    return float(np.mean(image[y[in_image], x[in_image]] > level_grey))


def _mark_strong(edges: RimEdges) -> Mask:
    if not edges.found.any():
        return edges.found
    typical = median(edges.step_grey[edges.found])
    return np.asarray(edges.step_grey > STEP_SHARE * typical)


def _mark_plausible(edges: RimEdges) -> Mask:
    strong = edges.found & _mark_strong(edges)
    if not strong.any():
        return strong
    blur = median(edges.blur_px[strong])
    usual = (edges.blur_px < BLUR_RATIO * blur) & (edges.blur_px > blur / BLUR_RATIO)
    return np.asarray(strong & usual & (edges.misfit_grey < MISFIT_SHARE * edges.step_grey))


def _mark_on_rim(fit: EllipseFit, points: Array) -> Mask:
    limit = min(max(OFF_RIM_SIGMAS * fit.sigma_px, OFF_RIM_PX), OFF_RIM_LIMIT_PX)
    return np.asarray(np.abs(fit.ellipse.distance_px(points)) < limit)


def _is_near(ellipse: Ellipse, guess: Circle, limit_px: float) -> bool:
    apart = math.dist(ellipse.centre_px, guess.centre_px)
    major, minor = ellipse.axes_px
    return apart < limit_px and abs(math.sqrt(major * minor) - guess.radius_px) < limit_px


@dataclass(frozen=True)
class Profiles:
    """Grey values along rays: `grey` (rays, samples); `inside` (rays,) is False if a ray leaves the image."""

    angle_rad: Array  # (rays,)
    base_px: Array  # (rays,): distance from the centre to offset 0
    offset_px: Array  # (samples,)
    grey: Array
    inside: Mask


@dataclass(frozen=True)
class RimEdges:
    """Edge on each ray: offset from the base, outer grey level, step height, blur, and model misfit."""

    offset_px: Array
    dark_grey: Array
    step_grey: Array
    blur_px: Array
    misfit_grey: Array
    found: Mask


def sample_profiles(image: GreyImage, ellipse: Ellipse, rays: int, half_width_px: float) -> Profiles:
    """Sample grey values at every pixel along `rays` rays, up to `half_width_px` either side of the rim."""
    angle: Array = np.arange(rays, dtype=float) * (2.0 * np.pi / rays)
    base = ellipse.radius_at(angle)
    offset = np.arange(-np.ceil(half_width_px), np.ceil(half_width_px) + 1.0)
    distance = base[:, None] + offset
    x = ellipse.centre_px[0] + np.cos(angle)[:, None] * distance
    y = ellipse.centre_px[1] + np.sin(angle)[:, None] * distance
    height, width = image.shape
    inside = ((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1) & (distance > 0)).all(axis=1)
    return Profiles(angle, base, offset, _interpolate(image, x, y), inside)


def rim_points(ellipse: Ellipse, profiles: Profiles, offset_px: Array) -> Array:
    """Return the positions (rays, 2) of edges offset by `offset_px` from the bases of their rays."""
    directions = np.stack([np.cos(profiles.angle_rad), np.sin(profiles.angle_rad)], axis=1)
    return np.asarray(ellipse.centre_px + directions * (profiles.base_px + offset_px)[:, None])


def steepest_falls(profiles: Profiles) -> RimEdges:
    """Find the steepest bright-to-dark transition on each ray, refined by parabolic interpolation."""
    fall = np.zeros_like(profiles.grey)
    fall[:, 1:-1] = 0.5 * (profiles.grey[:, :-2] - profiles.grey[:, 2:])
    rays = np.arange(len(fall))
    peak = np.clip(fall[:, 1:-1].argmax(axis=1) + 1, 2, fall.shape[1] - 3)
    before, top, after = fall[rays, peak - 1], fall[rays, peak], fall[rays, peak + 1]
    bend = before - 2.0 * top + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
    offset = profiles.offset_px[peak] + np.clip(shift, -1.0, 1.0)
    samples = np.arange(fall.shape[1])
    height = np.where(np.abs(samples - peak[:, None]) <= 4, np.maximum(fall, 0.0), 0.0).sum(axis=1)
    blur = INVERSE_ROOT_TWO_PI * height / np.maximum(top, 1e-9)
    dark = profiles.grey.min(axis=1)
    return RimEdges(offset, dark, height, blur, np.zeros_like(offset), profiles.inside & (top > 0))


def fit_blurred_steps(profiles: Profiles, start: RimEdges, blur_px: float) -> RimEdges:
    """Fit `B + (A + m (s - e)) * Phi((e - s) / w)` to every ray by Gauss-Newton (edge e, blur w).

    B, A and m are linear parameters, e and w are not; all five are iterated together from the steepest falls.
    """
    s = profiles.offset_px
    grey = profiles.grey
    rays = len(grey)
    edge = start.offset_px.copy()
    width = np.full(rays, max(blur_px, BLUR_FLOOR_PX))
    dark = np.median(grey[:, -4:], axis=1)
    height = np.maximum(np.median(grey[:, :4], axis=1) - dark, 1e-3)
    slope = np.zeros(rays)
    residual = np.zeros_like(grey)
    largest = 3.0 * max(blur_px, BLUR_FLOOR_PX)
    for iteration in range(STEP_ITERATIONS + 1):
        outward_px = s - edge[:, None]
        z = -outward_px / width[:, None]
        cover = ndtr(z)
        plateau = height[:, None] + slope[:, None] * outward_px
        residual = grey - (dark[:, None] + plateau * cover)
        if iteration == STEP_ITERATIONS:
            break
        bell = INVERSE_ROOT_TWO_PI * np.exp(-0.5 * z * z) / width[:, None]
        by_edge, by_width = plateau * bell - slope[:, None] * cover, plateau * bell * -z
        columns = [np.ones_like(z), cover, outward_px * cover, by_edge, by_width]
        jacobian = np.stack(columns, axis=1)  # (rays, 5, samples)
        normal = jacobian @ jacobian.transpose(0, 2, 1)
        diagonal = np.einsum("nii->ni", normal)
        diagonal *= 1.0 + DAMPING
        diagonal += 1e-9
        step = np.linalg.solve(normal, jacobian @ residual[:, :, None])[:, :, 0]
        dark, height, slope = dark + step[:, 0], height + step[:, 1], slope + step[:, 2]
        edge = np.clip(edge + np.clip(step[:, 3], -SHIFT_LIMIT_PX, SHIFT_LIMIT_PX), s[0], s[-1])
        width = np.clip(width + np.clip(step[:, 4], -0.5 * width, width), 0.3 * BLUR_FLOOR_PX, largest)
    misfit = np.sqrt(np.mean(residual**2, axis=1))
    found = start.found & (height > 0) & (edge > s[1]) & (edge < s[-2])
    return RimEdges(edge, dark, height, width, misfit, found)


def _interpolate(image: GreyImage, x: Array, y: Array) -> Array:
    """Interpolate grey values linearly, using the nearest border pixel outside the image."""
    height, width = image.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    column = np.minimum(x.astype(np.intp), width - 2)
    row = np.minimum(y.astype(np.intp), height - 2)
    right, down = x - column, y - row
    pixels, place = image.ravel(), row * width + column  # taking by one index is twice as fast
    top = pixels.take(place) * (1.0 - right) + pixels.take(place + 1) * right
    place += width
    bottom = pixels.take(place) * (1.0 - right) + pixels.take(place + 1) * right
    return np.asarray(top * (1.0 - down) + bottom * down, dtype=float)
