"""Measures a sphere whose surface has been found: by two estimators, or together with its streaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from procedures.imaging.region import Region
from procedures.imaging.sphere_centre.blurred_ball import fit_blurred_ball
from procedures.imaging.sphere_centre.combination import CombinedCentre, combine, is_streaked
from procedures.imaging.sphere_centre.radial_edge import RadialEdge, fit_radial_edge, ray_directions
from procedures.imaging.sphere_centre.streaked_ball import fit_streaked_ball

UNSCANNED_FLAG = 0.02  # share of rays that leave the field
SURFACE_FLAG = 0.70  # share of the surface seen


@dataclass(frozen=True, eq=False)
class Measured:
    """A sphere in grid mm; `metal_share` of its surface is too near metal to be used.

    `cleaned` is the region without its streaks where these had to be taken away, and `edge` the edge in it.
    """

    edge: RadialEdge
    combined: CombinedCentre
    metal_share: float
    cleaned: Region | None = None


def measure(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Measured | None:
    """The sphere to whose surface `edge` was fitted; None when no ball fits."""
    hidden = edge.surface_share < SURFACE_FLAG and edge.unscanned_share < UNSCANNED_FLAG
    ball = fit_blurred_ball(
        region,
        edge.centre_mm,
        edge.radius_mm,
        edge.inside_hu,
        edge.outside_hu,
        hidden_ways=ray_directions()[~edge.seen] if hidden else None,
    )
    if ball is not None and (hidden or not is_streaked(edge, ball)):
        return Measured(edge, combine(edge, ball, region.spacing_mm), ball.metal_share)
    under_streaks = measure_under_streaks(region, edge, nominal_radius_mm)
    if under_streaks is None and ball is not None:
        return Measured(edge, combine(edge, ball, region.spacing_mm), ball.metal_share)
    return under_streaks


def measure_under_streaks(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Measured | None:
    """The same together with the streaks in each slice."""
    ball = fit_streaked_ball(region, edge)
    if ball is None:
        return None
    cleaned = fit_radial_edge(ball.cleaned, ball.centre_mm, nominal_radius_mm, refine=True)
    if cleaned is None:
        return None
    apart_mm = float(np.linalg.norm(cleaned.centre_mm - ball.centre_mm))
    combined = CombinedCentre(ball.centre_mm, ball.covariance_mm2, apart_mm, ball.radius_mm)
    return Measured(cleaned, combined, ball.metal_share, ball.cleaned)
