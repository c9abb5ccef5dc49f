"""Whether a fitted outline is a sphere's, how good its centre is, and whether it is reliable.

Where a stain dims the film up to the rim, the outline is still visible: such rays do not support the ellipse,
but those with an edge on it count as visible rim.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.ellipse import Ellipse, EllipseFit
from procedures.relocalization.opencv_edges import GreyImage
from procedures.relocalization.rim_edges import RimEdges, sample_profiles, steepest_falls
from procedures.relocalization.sphere_image import SphereImage, SphereStatus

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
    0.99  # a sphere in the corner of the sensor has 0.996; below this, two objects share an outline
)
SPHERE_AXIS_RATIO = 0.75
RELIABLE_SCATTER_PX = 0.6
RELIABLE_CONTRAST_TO_NOISE = 6.0
TOO_FAINT = "the sphere is too faint"
FILLED_SHARE = 0.6  # of the inside that must be brighter than half of the step
FILLED_AREA = (0.02, 0.8)  # sampled range, as a share of the area from the centre
FILLED_RINGS, FILLED_RAYS = 12, 36
# Neighbouring rays share grain, uneven light and the edges of stains, so they carry less information than
# independent ones. With this factor covariances are correct on rendered images; films and lights of the
# hardware are unknown (U).
SHARED_ERRORS = 2.3


def judged(
    image: GreyImage, fit: EllipseFit, edges: RimEdges, bright: NDArray[np.bool_], rim: NDArray[np.bool_]
) -> SphereImage | None:
    """The outline with its quality; `rim` are the rays that support it, `bright` also their neighbours."""
    step, noise, blur = (
        float(np.median(values[rim])) for values in (edges.step_grey, edges.misfit_grey, edges.blur_px)
    )
    major, minor = fit.ellipse.axes_px
    least_grey = max(DIM_STEP_SHARE * step, DIM_NOISE_FACTOR * noise)
    dim = _dimmed(image, fit.ellipse, len(bright), blur, least_grey)
    rim_fraction, carrying = float(np.mean(bright | dim)), float(np.mean(bright))
    if rim_fraction < LEAST_RIM or minor / major < SPHERE_AXIS_RATIO:
        return None
    if _filled_share(image, fit.ellipse, edges, rim) < FILLED_SHARE:
        return None
    contrast_to_noise = step / max(noise, 1e-6)
    doubts = {
        "too much of the rim is hidden": rim_fraction < RELIABLE_RIM,
        "too much of the rim is stained": carrying < CARRYING_RIM,
        "the outline is not round": minor / major < RELIABLE_AXIS_RATIO,
        "the rim is too rough": fit.sigma_px > RELIABLE_SCATTER_PX,
        TOO_FAINT: contrast_to_noise < RELIABLE_CONTRAST_TO_NOISE,
    }
    doubt = next((words for words, holds in doubts.items() if holds), "")
    quality = (
        rim_fraction
        / (1.0 + (fit.sigma_px / RELIABLE_SCATTER_PX) ** 2)
        / (1.0 + (RELIABLE_CONTRAST_TO_NOISE / contrast_to_noise) ** 2)
    )
    covariance = SHARED_ERRORS * fit.centre_covariance_px2
    return SphereImage(
        centre_px=fit.ellipse.centre_px,
        axes_px=(major, minor),
        quality=min(1.0, max(0.0, quality)),
        status=SphereStatus.UNRELIABLE if doubt else SphereStatus.OK,
        covariance_px2=(
            (float(covariance[0, 0]), float(covariance[0, 1])),
            (float(covariance[1, 0]), float(covariance[1, 1])),
        ),
        rim_fraction=rim_fraction,
        scatter_px=fit.sigma_px,
        blur_px=blur,
        doubt=doubt,
    )


def _dimmed(
    image: GreyImage, ellipse: Ellipse, rays: int, blur_px: float, least_grey: float
) -> NDArray[np.bool_]:
    """Rays (n,) with an edge on the ellipse itself, however dim the film is there."""
    span_px = DIM_SPAN_BLURS * blur_px + DIM_SPAN_PX
    falls = steepest_falls(sample_profiles(image, ellipse, rays, span_px))
    on_rim = np.abs(falls.offset_px) < DIM_OFF_RIM_PX
    return np.asarray(falls.found & on_rim & (falls.step_grey > least_grey))


def _filled_share(image: GreyImage, ellipse: Ellipse, edges: RimEdges, rim: NDArray[np.bool_]) -> float:
    """Share of the inside that is brighter than halfway between the grey levels at the rim."""
    radius = np.sqrt(np.linspace(*FILLED_AREA, FILLED_RINGS))[:, None]  # equal area per sample
    angle: NDArray[np.float64] = np.arange(FILLED_RAYS, dtype=float) * (2.0 * np.pi / FILLED_RAYS)
    distance = radius * ellipse.radius_at(angle)
    x = np.rint(ellipse.centre_px[0] + distance * np.cos(angle)).astype(int)
    y = np.rint(ellipse.centre_px[1] + distance * np.sin(angle)).astype(int)
    seen = (x >= 0) & (x < image.shape[1]) & (y >= 0) & (y < image.shape[0])
    if not seen.any():
        return 0.0
    half_way = float(np.median((edges.dark_grey + 0.5 * edges.step_grey)[rim]))
    return float(np.mean(image[y[seen], x[seen]] > half_way))
