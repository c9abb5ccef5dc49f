"""The outline of one disc on the full image, near a guess: edges along rays, a robust ellipse through them.

The steepest falls along rays, a blurred step fitted to each ray, an ellipse. Rays whose edge is too weak, too
blurred, misfitted or off the ellipse are not rim: posts, occluders, stains and the image border cost rim, but
do not pull the centre.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.circle_search import Circle
from procedures.relocalization.ellipse import Ellipse, EllipseFit, circle, fit_ellipse
from procedures.relocalization.opencv_edges import GreyImage
from procedures.relocalization.outline_quality import judged
from procedures.relocalization.rim_edges import (
    RimEdges,
    fit_blurred_steps,
    rim_points,
    sample_profiles,
    steepest_falls,
)
from procedures.relocalization.sphere_image import SphereImage

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


def refined(image: GreyImage, guess: Circle, factor: int) -> SphereImage | None:
    """The ellipse at full resolution near a guess, or None when there is no disc."""
    span_px = max(COARSE_SPAN_PX * factor, COARSE_SPAN * guess.radius_px)
    start = circle(guess.centre_px, guess.radius_px)
    coarse_profiles = sample_profiles(image, start, COARSE_RAYS, span_px)
    falls = steepest_falls(coarse_profiles)
    rim = falls.found & _strong(falls)
    coarse = fit_ellipse(rim_points(start, coarse_profiles, falls.offset_px)[rim], start)
    if coarse is None or not _near(coarse.ellipse, guess, span_px):
        return None
    blur = float(np.median(falls.blur_px[rim]))
    for _ in range(BLUR_ATTEMPTS):
        span_px = FINE_SPAN_BLURS * blur + FINE_SPAN_PX
        profiles = sample_profiles(image, coarse.ellipse, FINE_RAYS, span_px)
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
    inner = rim & np.roll(rim, 1) & np.roll(rim, -1)  # a ray next to a lost one is affected by the occluder
    fit = fit_ellipse(points[inner], first.ellipse, rough_start=False)
    if fit is None or not _near(fit.ellipse, guess, 2.0 * COARSE_SPAN_PX * factor + span_px):
        return None
    return judged(image, fit, edges, rim, inner)


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


def _on_rim(fit: EllipseFit, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    limit = min(max(OFF_RIM_SIGMAS * fit.sigma_px, OFF_RIM_PX), OFF_RIM_LIMIT_PX)
    return np.asarray(np.abs(fit.ellipse.distance_px(points)) < limit)


def _near(ellipse: Ellipse, guess: Circle, limit_px: float) -> bool:
    apart = math.dist(ellipse.centre_px, guess.centre_px)
    major, minor = ellipse.axes_px
    return apart < limit_px and abs(math.sqrt(major * minor) - guess.radius_px) < limit_px
