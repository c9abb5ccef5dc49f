"""Measures a sphere whose surface has been found: with two estimators, or jointly with its streaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from procedures.imaging.region import Region
from procedures.imaging.sphere_centre.blurred_ball import BlurredBall, fit_rough_ball
from procedures.imaging.sphere_centre.combination import STREAKED, CombinedCentre, combine, is_streaked
from procedures.imaging.sphere_centre.radial_edge import (
    RadialEdge,
    fit_radial_edge,
    is_polymer,
    ray_directions,
)
from procedures.imaging.sphere_centre.streaked_ball import fit_streaked_ball
from procedures.imaging.sphere_centre.stretch import Stretch

UNSCANNED_FLAG = 0.02  # share of rays that leave the field
SURFACE_FLAG = 0.70  # share of the surface seen
STREAKED_AT_SIGHT = 0.12  # of the contrast: unevenness found by a robust fit; noise and posts stay below 0.08
MORE_SEEN = 0.1  # of the surface


@dataclass(frozen=True, eq=False)
class Measured:
    """A sphere in grid mm; `metal_share` is the part of its surface too close to metal to be used.

    `cleaned` is the region with the streaks removed, where that was necessary, and `edge` the edge in it.
    `evident` means that the streaks also show away from the edge and may excuse its shape. `stretch` is None
    if too little of the surface shows to determine it from the voxels.
    """

    edge: RadialEdge
    combined: CombinedCentre
    metal_share: float
    stretch: Stretch | None
    cleaned: Region | None = None
    evident: bool = False


def measure(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Measured | None:
    """The sphere whose surface `edge` was fitted to; None if no ball fits.

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
) -> Measured | None:
    if ball is None:
        return None
    combined = combine(edge, ball, region.spacing_mm)
    return Measured(edge, combined, ball.metal_share, None if directions_from_rays else ball.stretch)


def measure_under_streaks(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Measured | None:
    """The same, fitted together with the streaks in each slice.

    Streaks hide directions from the rays: what shows once they are removed is used when the
    ball is fitted again.
    """
    first = _without_streaks(region, edge, nominal_radius_mm)
    if first is None or first.edge.surface_share < edge.surface_share + MORE_SEEN:
        return first
    return _without_streaks(region, first.edge, nominal_radius_mm) or first


def _without_streaks(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Measured | None:
    # The difference from the edge is not added to the ball's covariance, which is wide enough: with it chi
    # squared / 3n fell from 0.76 to 0.69 (`rays`, good, 14 spheres), elsewhere by up to 0.05.
    ball = fit_streaked_ball(region, edge)
    if ball is None:
        return None
    cleaned = fit_radial_edge(ball.cleaned, ball.centre_mm, nominal_radius_mm, refine=True)
    if cleaned is None:
        return None
    apart_mm = float(np.linalg.norm(cleaned.centre_mm - ball.centre_mm))
    combined = CombinedCentre(ball.centre_mm, ball.covariance_mm2, apart_mm, ball.radius_mm)
    return Measured(cleaned, combined, ball.metal_share, ball.stretch, ball.cleaned, ball.evident)
