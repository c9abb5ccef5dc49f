"""Measure a sphere whose surface has been found, by two estimators or jointly with its streaks.

The estimators see the same noise, so their errors are correlated. Where they differ by more than noise
explains, the image fits neither model, and the difference is added to the covariance. A streak band across
the ball can pull the model's radius and intensities far off, and its centre with them. Edges found by rays
cannot move that far: then they alone determine centre and radius.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.markers import EVEN, Doubt, odds, reasons
from procedures.imaging.sphere_centre.ball_model import Stretch
from procedures.imaging.sphere_centre.blurred_ball import BlurredBall, fit_rough_ball
from procedures.imaging.sphere_centre.radial_edge import (
    RadialEdge,
    fit_radial_edge,
    is_polymer,
    ray_directions,
)
from procedures.imaging.sphere_centre.streaked_ball import fit_streaked_ball
from procedures.imaging.volume import Region

Array = NDArray[np.float64]

# measured on synthetic spheres, noise 20 and 50 HU, voxels of 0.5 x 0.5 x 1 and 0.7 x 0.7 x 2 mm
RAY_CORRELATION = 2.0  # neighbouring rays share voxels: variance relative to independent rays
INTERPOLATION_ERROR_PER_MM = 0.004  # mm of error per mm² of voxel size, from interpolation between voxels
SLICE_PROFILE_ERROR_PER_MM = 0.0003  # mm per mm²: a voxel is a box, the model's blur a Gaussian
ERROR_CORRELATION = 0.6  # between the errors of the two estimators
# Streaks move the edges found by rays: 3-D error for bend terms as large as the contrast. From the tuning
# families and synthetic bands and lobes on `plain`.
EDGE_STREAK_ERROR_MM = 2.0
# By how much of it the ball's radius exceeds that of the edges, with film and blur, in an undisturbed fit:
# 0.03 to 0.13 mm on the tuning families. Bands make it -0.16 to 1.8 mm.
RADIUS_ABOVE_EDGES = (-0.005, 0.026)
AGREEMENT_MM = 0.06  # beyond this the two estimators contradict each other
STREAKED = 0.0075  # bend terms relative to the contrast: up to 0.004 without streaks
ENOUGH_SURFACE = 0.7  # for the edges to be used alone
UNSCANNED_FLAG = 0.02  # share of rays that leave the field
SURFACE_FLAG = 0.70  # share of the surface seen
STREAKED_AT_SIGHT = 0.12  # of the contrast: unevenness found by a robust fit; noise and posts stay below 0.08
MORE_SEEN = 0.1  # of the surface

IS_MARKER = "is a marker"


@dataclass(frozen=True, eq=False)
class Sphere:
    """A measured sphere in grid mm (slice, row, column), and the doubts that it is a marker.

    `agreement_mm` is the distance between both estimates of the centre, `metal_share` the part of the surface
    too close to metal to be used. `stretch` is None if too little of the surface shows to determine it from
    the voxels. `cleaned` is the region without its streaks, if they had to be removed; `edge` is then the
    edge in it. `evident` streaks also show away from the edge and may excuse its shape. `contrast_hu` is the
    detector's. A `picked` sphere counts as a marker despite its doubts.
    """

    edge: RadialEdge
    centre_mm: Array
    covariance_mm2: Array
    radius_mm: float
    agreement_mm: float
    metal_share: float
    stretch: Stretch | None
    cleaned: Region | None = None
    evident: bool = False
    contrast_hu: float = 0.0
    doubts: tuple[Doubt, ...] = ()
    picked: bool = False

    def with_doubts(self, doubts: Iterable[Doubt]) -> Sphere:
        """Add doubts, which may push the odds below even."""
        return replace(self, doubts=(*self.doubts, *doubts))

    @property
    def odds(self) -> float:
        """Odds [0..1] that this is a marker."""
        return odds(self.doubts)

    @property
    def accepted(self) -> bool:
        """Whether this counts as a marker."""
        return self.picked or self.odds >= EVEN

    @property
    def reason(self) -> str:
        """Verdict in words, for the candidate list."""
        return IS_MARKER if self.odds >= EVEN else f"is doubtful: {reasons(self.doubts)}"


def measure(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Sphere | None:
    """Measure the sphere whose surface `edge` was fitted to; None if no ball fits.

    A level that no polymer has is possible only if there are streaks to explain it.
    """
    if not is_polymer(edge):
        under_streaks = measure_under_streaks(region, edge, nominal_radius_mm)
        return under_streaks if under_streaks is not None and under_streaks.evident else None
    hidden = edge.surface_share < SURFACE_FLAG and edge.unscanned_share < UNSCANNED_FLAG
    unseen = ray_directions()[~edge.seen]
    rough = fit_rough_ball(
        region,
        edge.centre_mm,
        edge.radius_mm,
        edge.inside_hu,
        edge.outside_hu,
        hidden_ways=unseen if hidden else None,
    )
    if rough is None:
        return measure_under_streaks(region, edge, nominal_radius_mm)
    if hidden:
        return _by_both(region, edge, rough.refined(unseen), directions_from_rays=True)
    under_streaks = None
    if rough.uneven > STREAKED_AT_SIGHT:
        under_streaks = measure_under_streaks(region, edge, nominal_radius_mm)
        if under_streaks is not None and under_streaks.evident:
            return under_streaks
    ball = rough.refined(unseen, most_streaks=STREAKED)
    if ball is not None and not is_streaked(edge, ball):
        return _by_both(region, edge, ball)
    under_streaks = under_streaks or measure_under_streaks(region, edge, nominal_radius_mm)
    return under_streaks or _by_both(region, edge, ball or rough.refined(unseen))


def _by_both(
    region: Region, edge: RadialEdge, ball: BlurredBall | None, *, directions_from_rays: bool = False
) -> Sphere | None:
    if ball is None:
        return None
    sphere = combine(edge, ball, region.spacing_mm)
    return replace(sphere, stretch=None) if directions_from_rays else sphere


def measure_under_streaks(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Sphere | None:
    """Measure the sphere together with the streaks in each slice.

    Streaks hide directions from the rays. Those that show once they are removed are used in a second fit.
    """
    first = _without_streaks(region, edge, nominal_radius_mm)
    if first is None or first.edge.surface_share < edge.surface_share + MORE_SEEN:
        return first
    return _without_streaks(region, first.edge, nominal_radius_mm) or first


def _without_streaks(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Sphere | None:
    # The difference from the edge is not added to the ball's covariance, which is wide enough: with it chi
    # squared / 3n fell from 0.76 to 0.69 (`rays`, good, 14 spheres), elsewhere by up to 0.05.
    ball = fit_streaked_ball(region, edge)
    if ball is None:
        return None
    cleaned = fit_radial_edge(ball.cleaned, ball.centre_mm, nominal_radius_mm, refine=True)
    if cleaned is None:
        return None
    return Sphere(
        edge=cleaned,
        centre_mm=ball.centre_mm,
        covariance_mm2=ball.covariance_mm2,
        radius_mm=ball.radius_mm,
        agreement_mm=float(np.linalg.norm(cleaned.centre_mm - ball.centre_mm)),
        metal_share=ball.metal_share,
        stretch=ball.stretch,
        cleaned=ball.cleaned,
        evident=ball.evident,
    )


def combine(edge: RadialEdge, ball: BlurredBall, spacing_mm: Array) -> Sphere:
    """Combine both estimates into their minimum-variance mean (generalized least squares)."""
    if _is_spoiled(edge, ball):
        return _by_edges(edge, ball, spacing_mm)
    first = _edge_covariance(edge, spacing_mm, ball.streak_hu / abs(ball.contrast_hu))
    second = ball.covariance_mm2 + np.diag((SLICE_PROFILE_ERROR_PER_MM * spacing_mm**2) ** 2)
    # an estimate that adds no information gets zero weight rather than a negative one
    correlation = min(ERROR_CORRELATION, float(np.sqrt(np.trace(second) / np.trace(first))))
    cross = correlation * _root(first) @ _root(second)
    difference = edge.centre_mm - ball.centre_mm
    spread = first + second - cross - cross.T  # covariance of the difference
    gain = (second - cross.T) @ np.linalg.inv(spread)
    centre_mm = ball.centre_mm + gain @ difference
    covariance = second - gain @ (second - cross)
    excess = max(0.0, float(difference @ difference) - float(np.trace(spread)))
    if excess > 0.0:
        direction = difference / np.linalg.norm(difference)
        covariance = covariance + 0.0625 * excess * (np.outer(direction, direction) + np.eye(3))
    return Sphere(
        edge=edge,
        centre_mm=centre_mm,
        covariance_mm2=0.5 * (covariance + covariance.T),
        radius_mm=ball.radius_mm,
        agreement_mm=float(np.linalg.norm(difference)),
        metal_share=ball.metal_share,
        stretch=ball.stretch,
    )


def is_streaked(edge: RadialEdge, ball: BlurredBall) -> bool:
    """Whether streaks bend the background so much that neither fit's covariance can be trusted."""
    apart_mm = float(np.linalg.norm(edge.centre_mm - ball.centre_mm))
    bent = ball.streak_hu > STREAKED * abs(ball.contrast_hu)
    return bent or apart_mm > AGREEMENT_MM or _is_spoiled(edge, ball)


def _is_spoiled(edge: RadialEdge, ball: BlurredBall) -> bool:
    low, high = RADIUS_ABOVE_EDGES
    above = ball.radius_mm / edge.radius_mm - 1.0
    return edge.surface_share >= ENOUGH_SURFACE and not low < above < high


def _by_edges(edge: RadialEdge, ball: BlurredBall, spacing_mm: Array) -> Sphere:
    streaks = ball.streak_hu / abs(edge.inside_hu - edge.outside_hu)
    covariance = _edge_covariance(edge, spacing_mm, streaks)
    return Sphere(
        edge=edge,
        centre_mm=edge.centre_mm,
        covariance_mm2=0.5 * (covariance + covariance.T),
        radius_mm=edge.radius_mm,
        agreement_mm=float(np.linalg.norm(edge.centre_mm - ball.centre_mm)),
        metal_share=ball.metal_share,
        stretch=ball.stretch,
    )


def _edge_covariance(edge: RadialEdge, spacing_mm: Array, streaks: float) -> Array:
    """Covariance of the edge's centre under streak bend terms of this size relative to the contrast."""
    interpolation = np.diag((INTERPOLATION_ERROR_PER_MM * spacing_mm**2) ** 2)
    streaks_mm = EDGE_STREAK_ERROR_MM * streaks
    return RAY_CORRELATION * edge.covariance_mm2 + interpolation + streaks_mm**2 / 3.0 * np.eye(3)


def _root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
