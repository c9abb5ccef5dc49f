"""Where a retro-reflective sphere stands in one image: centre, semi-axes, quality.

Reduce, guess circles from edges, then refine the best on the full image: steepest falls along rays, a
blurred step fitted to every ray, a robust ellipse through the edges. Rays whose edge is too weak, too
blurred, misfitted or off the ellipse are not rim: post, occluders, stains and the border of the image cost
rim, they do not pull the centre. Where a stain dims the film up to the rim, the outline is still seen: such
rays do not carry the ellipse, but those that fall off on it count as rim in view.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.circle_start import Circle, find_circles
from procedures.relocalization.ellipse import Ellipse, EllipseFit, circle, fit_ellipse
from procedures.relocalization.errors import BadImage, NoContrast, NoSphere, Saturated
from procedures.relocalization.rim import (
    RimEdges,
    fit_blurred_steps,
    rim_points,
    sample_profiles,
    steepest_falls,
)
from procedures.relocalization.vision import GreyImage, find_edges, reduce_image

REDUCED_SIDE_PX = 512  # the longer side of the image in which circles are sought
SMALLEST_SIDE_PX = 48
TWELVE_BIT_LIMIT = 4095
SMALLEST_RADIUS_PX = 8.0  # of the reduced image: below this the rim has too few pixels to judge
DARK_PERCENTILE = 2.0
BRIGHT_PERCENTILE = 99.8
CONTRAST_FLOOR = 0.02  # of the grey range: less is noise or an even field
SATURATED_LEVEL, DARK_LEVEL = 0.95, 0.15  # of the grey range, of an image without contrast

COARSE_RAYS = 180
FINE_RAYS = 300
COARSE_REACH = 0.05  # of the radius, to each side of the first guess
COARSE_REACH_PX = 3.0  # of the reduced image, at least
FINE_REACH_BLURS = 4.0
BLUR_ATTEMPTS = 3  # a first look at a defocused rim sees only the middle of its fall
BLUR_GROWTH = 1.5
FINE_REACH_PX = 6.0  # beyond the blur: enough plateau to see both grey levels

STEP_SHARE = 0.35  # of the median step: less is the sphere against its post, or a shadow
BLUR_RATIO = 2.5  # to each side of the median blur
MISFIT_SHARE = 0.25  # of the step
OFF_RIM_SIGMAS = 4.0
OFF_RIM_PX = 0.35  # never stricter than this: grain and small dents are still rim
OFF_RIM_LIMIT_PX = 1.5
# Rim below a stain: the fall from the dimmed film to the background, within a window too narrow for the
# stain's own edge to matter. Blood and liquid leave 0.2 to 0.4 of the light (U).
DIM_STEP_SHARE = 0.15
DIM_NOISE_FACTOR = 6.0  # a fall of noise alone is smaller
DIM_REACH_BLURS, DIM_REACH_PX = 3.0, 2.0
DIM_OFF_RIM_PX = 0.7  # the stain's inner edge pulls the steepest place by about half a pixel

LEAST_RIM = 0.25  # below this it is not a sphere at all
RELIABLE_RIM = 0.625  # of the rim in view; 38 % lost must never pass
CARRYING_RIM = 0.5  # of the rim must carry the ellipse, without what a stain dims
RELIABLE_AXIS_RATIO = 0.99  # a sphere in the corner of the sensor has 0.996: then two things are one outline
SPHERE_AXIS_RATIO = 0.75
RELIABLE_SCATTER_PX = 0.6
RELIABLE_CONTRAST_TO_NOISE = 6.0
FILLED_SHARE = 0.6  # of the inside that must be brighter than half the step
MODEL_ERROR_PX = 0.01  # grain and uneven light move the centre by about this much whatever the noise


class SphereStatus(StrEnum):
    """Whether a centre may be used for a measurement."""

    OK = "OK"
    UNRELIABLE = "UNRELIABLE"


@dataclass(frozen=True)
class SphereImage:
    """A sphere in an image. (0, 0) is the centre of the top-left pixel; perspective bias is still in it.

    `axes_px` are semi-axes, major first. `quality` 0..1 falls with lost rim, scatter and noise.
    `covariance_px2` is that of the centre, x and y. `rim_fraction` is the share of the rim that was seen.
    """

    centre_px: tuple[float, float]
    axes_px: tuple[float, float]
    quality: float
    status: SphereStatus
    covariance_px2: tuple[tuple[float, float], tuple[float, float]]
    rim_fraction: float
    scatter_px: float
    blur_px: float

    def shifted(self, offset_x_px: float, offset_y_px: float) -> SphereImage:
        """The same sphere in pixels of the full sensor, from the offsets of an area of interest."""
        x, y = self.centre_px
        return replace(self, centre_px=(x + offset_x_px, y + offset_y_px))


def measure_sphere(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    *,
    radius_range_px: tuple[float, float] | None = None,
) -> SphereImage:
    """The bright sphere with the most visible rim in a 2-D uint8 or uint16 (12-bit) image, left untouched.

    Any byte order is taken. `radius_range_px` keeps out discs of another size when the size is known.
    Raises STE-001 for an input that is no such image, STE-002 without contrast, STE-011 when all is
    saturated, STE-003 when no sphere is in view. A sphere of which too little rim is seen comes back as
    UNRELIABLE.
    """
    best: SphereImage | None = None
    round_shapes = 0
    for sphere in _spheres(image, radius_range_px):
        round_shapes += 1
        if sphere is None:
            continue
        if sphere.status is SphereStatus.OK:
            return sphere
        if best is None or _visible_px(sphere) > _visible_px(best):
            best = sphere
    if best is None:
        raise NoSphere(
            "no sphere in view", awaited="a bright disc", last=f"{round_shapes} round shape(s), none a sphere"
        )
    return best


def measure_spheres(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    *,
    radius_range_px: tuple[float, float] | None = None,
) -> tuple[SphereImage, ...]:
    """Every distinct disc in the image that may be a sphere, the one with the longest visible rim first.

    Takes and raises what `measure_sphere` does, except that nothing found is no error.
    """
    return tuple(sphere for sphere in _spheres(image, radius_range_px) if sphere is not None)


def _spheres(
    image: NDArray[np.uint8] | NDArray[np.uint16], radius_range_px: tuple[float, float] | None
) -> Iterator[SphereImage | None]:
    """Each round shape, measured only when it is asked for; None where it is no disc."""
    grey = _checked(image)
    factor = max(1, math.ceil(max(grey.shape) / REDUCED_SIDE_PX))
    reduced = reduce_image(grey, factor)
    dark, bright = (
        float(value) for value in np.percentile(reduced[::2, ::2], (DARK_PERCENTILE, BRIGHT_PERCENTILE))
    )
    full_range = 255.0 if grey.dtype == np.uint8 else float(TWELVE_BIT_LIMIT)
    if bright - dark < CONTRAST_FLOOR * full_range:
        _refuse_even(dark, bright, full_range)
    low, high = radius_range_px or (SMALLEST_RADIUS_PX * factor, 0.75 * max(grey.shape))
    guesses = find_circles(find_edges(reduced, dark, bright), 0.95 * low / factor, 1.05 * high / factor)
    for guess in guesses:  # the longest visible rim first
        sphere = _refine(grey, _enlarged(guess, factor), factor)
        in_range = sphere is not None and low <= math.sqrt(math.prod(sphere.axes_px)) <= high
        yield sphere if in_range else None


def _refuse_even(dark: float, bright: float, full_range: float) -> NoReturn:
    limit, last = f"{CONTRAST_FLOOR * full_range:.0f} grey values apart", f"{dark:.0f} to {bright:.0f}"
    if dark >= SATURATED_LEVEL * full_range:
        raise Saturated("the image is saturated", limit=limit, last=last)
    evenness = "dark all over" if bright <= DARK_LEVEL * full_range else "even: it has no contrast"
    raise NoContrast(f"the image is {evenness}", limit=limit, last=last)


def _visible_px(sphere: SphereImage) -> float:
    return sphere.rim_fraction * sphere.axes_px[0]


def _checked(image: object) -> GreyImage:
    if not isinstance(image, np.ndarray):
        raise BadImage("the image is not an array", last=type(image).__name__)
    native = image.dtype.newbyteorder("=")
    if image.ndim != 2 or native not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise BadImage("the image is not a grey image", last=f"{image.ndim}-D {image.dtype}")
    if min(image.shape) < SMALLEST_SIDE_PX:
        raise BadImage("the image is too small", limit=f"{SMALLEST_SIDE_PX} px", last=str(image.shape))
    if native == np.uint16 and int(image.max()) > TWELVE_BIT_LIMIT:
        raise BadImage("values of more than 12 bits", limit=str(TWELVE_BIT_LIMIT), last=str(image.max()))
    return image.astype(native, copy=False)  # OpenCV takes the byte order of this machine only


def _enlarged(guess: Circle, factor: int) -> Circle:
    x, y = (factor * (value + 0.5) - 0.5 for value in guess.centre_px)
    return Circle((x, y), factor * guess.radius_px, guess.coverage)


def _refine(image: GreyImage, guess: Circle, factor: int) -> SphereImage | None:
    """The ellipse at full resolution near a guess, or None when there is no disc."""
    reach = max(COARSE_REACH_PX * factor, COARSE_REACH * guess.radius_px)
    start = circle(guess.centre_px, guess.radius_px)
    coarse_profiles = sample_profiles(image, start, COARSE_RAYS, reach)
    falls = steepest_falls(coarse_profiles)
    rim = falls.found & _strong(falls)
    coarse = fit_ellipse(rim_points(start, coarse_profiles, falls.offset_px)[rim], start)
    if coarse is None or not _near(coarse.ellipse, guess, reach):
        return None
    blur = float(np.median(falls.blur_px[rim]))
    for _ in range(BLUR_ATTEMPTS):
        reach = FINE_REACH_BLURS * blur + FINE_REACH_PX
        profiles = sample_profiles(image, coarse.ellipse, FINE_RAYS, reach)
        edges = fit_blurred_steps(profiles, steepest_falls(profiles), blur)
        assumed, blur = blur, float(np.median(edges.blur_px))
        if blur < BLUR_GROWTH * assumed:
            break
    points = rim_points(coarse.ellipse, profiles, edges.offset_px)
    rim = _plausible(edges)
    first = fit_ellipse(points[rim], coarse.ellipse, rough_start=False)
    if first is None:
        return None
    rim &= _on_rim(first, points)
    inner = rim & np.roll(rim, 1) & np.roll(rim, -1)  # a ray beside a lost one is touched by what hides it
    fit = fit_ellipse(points[inner], first.ellipse, rough_start=False)
    if fit is None or not _near(fit.ellipse, guess, 2.0 * COARSE_REACH_PX * factor + reach):
        return None
    return _judged(image, fit, edges, rim, inner)


def _judged(
    image: GreyImage, fit: EllipseFit, edges: RimEdges, bright: NDArray[np.bool_], rim: NDArray[np.bool_]
) -> SphereImage | None:
    """The outline with its quality; `rim` are the rays that carry it, `bright` those and their neighbours."""
    step, noise = float(np.median(edges.step_grey[rim])), float(np.median(edges.misfit_grey[rim]))
    major, minor = fit.ellipse.axes_px
    dim = _dimmed(image, fit.ellipse, float(np.median(edges.blur_px[rim])), step, noise)
    rim_fraction, carrying = float(np.mean(bright | dim)), float(np.mean(bright))
    if rim_fraction < LEAST_RIM or minor / major < SPHERE_AXIS_RATIO:
        return None
    if _filled_share(image, fit.ellipse, edges, rim) < FILLED_SHARE:
        return None
    contrast_to_noise = step / max(noise, 1e-6)
    reliable = (
        rim_fraction >= RELIABLE_RIM
        and carrying >= CARRYING_RIM
        and minor / major >= RELIABLE_AXIS_RATIO
        and fit.sigma_px <= RELIABLE_SCATTER_PX
        and contrast_to_noise >= RELIABLE_CONTRAST_TO_NOISE
    )
    quality = (
        rim_fraction
        / (1.0 + (fit.sigma_px / RELIABLE_SCATTER_PX) ** 2)
        / (1.0 + (RELIABLE_CONTRAST_TO_NOISE / contrast_to_noise) ** 2)
    )
    covariance = fit.centre_covariance_px2 + MODEL_ERROR_PX**2 * np.eye(2)
    return SphereImage(
        centre_px=fit.ellipse.centre_px,
        axes_px=(major, minor),
        quality=min(1.0, max(0.0, quality)),
        status=SphereStatus.OK if reliable else SphereStatus.UNRELIABLE,
        covariance_px2=(
            (float(covariance[0, 0]), float(covariance[0, 1])),
            (float(covariance[1, 0]), float(covariance[1, 1])),
        ),
        rim_fraction=rim_fraction,
        scatter_px=fit.sigma_px,
        blur_px=float(np.median(edges.blur_px[rim])),
    )


def _strong(edges: RimEdges) -> NDArray[np.bool_]:
    if not edges.found.any():
        return edges.found
    typical = float(np.median(edges.step_grey[edges.found]))
    return np.asarray(edges.step_grey > STEP_SHARE * typical)


def _plausible(edges: RimEdges) -> NDArray[np.bool_]:
    strong = edges.found & _strong(edges)
    if not strong.any():
        return strong
    blur = float(np.median(edges.blur_px[strong]))
    usual = (edges.blur_px < BLUR_RATIO * blur) & (edges.blur_px > blur / BLUR_RATIO)
    return np.asarray(strong & usual & (edges.misfit_grey < MISFIT_SHARE * edges.step_grey))


def _dimmed(
    image: GreyImage, ellipse: Ellipse, blur_px: float, step_grey: float, noise_grey: float
) -> NDArray[np.bool_]:
    """Rays (n,) on which the light falls on the ellipse itself, however dim the film is there."""
    falls = steepest_falls(
        sample_profiles(image, ellipse, FINE_RAYS, DIM_REACH_BLURS * blur_px + DIM_REACH_PX)
    )
    least_grey = max(DIM_STEP_SHARE * step_grey, DIM_NOISE_FACTOR * noise_grey)
    on_rim = np.abs(falls.offset_px) < DIM_OFF_RIM_PX
    return np.asarray(falls.found & on_rim & (falls.step_grey > least_grey))


def _on_rim(fit: EllipseFit, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    limit = min(max(OFF_RIM_SIGMAS * fit.sigma_px, OFF_RIM_PX), OFF_RIM_LIMIT_PX)
    return np.asarray(np.abs(fit.ellipse.distance_px(points)) < limit)


def _near(ellipse: Ellipse, guess: Circle, limit_px: float) -> bool:
    apart = math.dist(ellipse.centre_px, guess.centre_px)
    major, minor = ellipse.axes_px
    return apart < limit_px and abs(math.sqrt(major * minor) - guess.radius_px) < limit_px


def _filled_share(image: GreyImage, ellipse: Ellipse, edges: RimEdges, rim: NDArray[np.bool_]) -> float:
    """Share of the inside that is brighter than half way between the grey levels of the rim."""
    radius = np.sqrt(np.linspace(0.02, 0.8, 12))[:, None]
    angle: NDArray[np.float64] = np.arange(36, dtype=float) * (2.0 * np.pi / 36)
    reach = radius * ellipse.radius_at(angle)
    x = np.rint(ellipse.centre_px[0] + reach * np.cos(angle)).astype(int)
    y = np.rint(ellipse.centre_px[1] + reach * np.sin(angle)).astype(int)
    seen = (x >= 0) & (x < image.shape[1]) & (y >= 0) & (y < image.shape[0])
    if not seen.any():
        return 0.0
    half_way = float(np.median((edges.dark_grey + 0.5 * edges.step_grey)[rim]))
    return float(np.mean(image[y[seen], x[seen]] > half_way))
