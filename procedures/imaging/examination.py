"""Decide whether a place in the scan holds a marker: find a surface, check its size, measure and judge it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.doubts import OVERLAP, shape_doubts
from procedures.imaging.markers import (
    CUT_BY_FIELD,
    ESTIMATORS_DISAGREE,
    NEAR_ANOTHER,
    NEAR_METAL,
    RADIUS_UNUSUAL,
    STREAKED,
    SURFACE_HIDDEN,
    Candidate,
    Doubt,
    Marker,
)
from procedures.imaging.measurement import (
    AGREEMENT_MM,
    SURFACE_FLAG,
    UNSCANNED_FLAG,
    Sphere,
    measure,
    measure_under_streaks,
)
from procedures.imaging.sphere_centre.radial_edge import RadialEdge, fit_radial_edge, is_polymer
from procedures.imaging.volume import Region, Volume, cut_region

Array = NDArray[np.float64]

NOT_POLYMER = "shows no surface of a polymer sphere"
OVERLAPS = "overlaps a marker, as two spheres cannot"
REGION_REACH = 2.2  # of the radius
MIN_SURFACE_SHARE = 0.5
COVERED_SURFACE_SHARE = 0.35  # enough if what covers the rest shows an edge there
COVERED_COHERENCE = 0.85
COVERED_STEP_HU = 30.0  # a moist bandage is 50 to 100 HU below the polymer
RADIUS_TOLERANCE = 0.061  # of the radius: 0.35 mm for the usual sphere

CUT_FLAG = 0.005  # share of rays that leave the field before the sphere's edge: two of 400
METAL_FLAG = 0.17  # share of the surface near metal; a post takes 0.10 to 0.13
RADIUS_FLAG = 0.045  # of the radius: 0.26 mm
NEAR_ANOTHER_FLAG = 1.6  # distance between centres, in diameters


def examine(
    volume: Volume,
    place_mm: Array,
    contrast_hu: float,
    radius_mm: float,
    known: list[Sphere],
    *,
    min_surface_share: float = MIN_SURFACE_SHARE,
) -> Sphere | Candidate:
    """Examine a place (3,) grid mm; return a sphere, or the candidate with the reason why it is none."""

    def rejected(edge: RadialEdge | None, reason: str) -> Candidate:
        return Candidate(
            centre_mm=_patient(volume, edge.centre_mm if edge is not None else place_mm),
            accepted=False,
            reason=reason,
            contrast_hu=contrast_hu,
            surface_share=edge.surface_share if edge is not None else None,
            radius_mm=edge.radius_mm if edge is not None else None,
        )

    region = cut_region(volume, place_mm, REGION_REACH * radius_mm)
    edge = fit_radial_edge(region, place_mm, radius_mm)
    if edge is None:
        return rejected(None, NOT_POLYMER)
    if edge.surface_share < min_surface_share and not _is_half_covered(edge):
        seen = f"{edge.surface_share:.0%} of a sphere's surface"
        cut = edge.cut_share > CUT_FLAG
        return rejected(
            edge, f"is cut off by the field of view, shows {seen}" if cut else f"shows only {seen}"
        )
    if abs(edge.radius_mm - radius_mm) > RADIUS_TOLERANCE * radius_mm:
        return rejected(edge, f"has radius {edge.radius_mm:.2f} mm instead of {radius_mm:.2f}")
    distances_mm = [float(np.linalg.norm(edge.centre_mm - other.centre_mm)) for other in known]
    if min(distances_mm, default=np.inf) < radius_mm:
        return rejected(edge, "is a marker that was already found")
    if min(distances_mm, default=np.inf) < OVERLAP * 2.0 * radius_mm:
        return rejected(edge, OVERLAPS)
    region = cut_region(volume, edge.centre_mm, REGION_REACH * radius_mm)
    refined = fit_radial_edge(region, edge.centre_mm, radius_mm, refine=True) or edge
    sphere = measure(region, refined, radius_mm)
    if sphere is None:
        reason = "fits no blurred sphere" if is_polymer(refined) else NOT_POLYMER
        return rejected(refined, reason)
    return replace(sphere, contrast_hu=contrast_hu)


def judge_shape(sphere: Sphere, volume: Volume, radius_mm: float) -> Sphere:
    """Add the doubts about a sphere's shape.

    Streaks distort a shape: a doubtful sphere is judged again without its streaks, and accepted if that
    clears it.
    """
    edge = sphere.edge
    region = cut_region(volume, sphere.centre_mm, REGION_REACH * edge.radius_mm)
    judged = sphere.with_doubts(_doubts(sphere, region))
    if judged.accepted or sphere.cleaned is not None:
        return judged
    region = cut_region(volume, edge.centre_mm, REGION_REACH * radius_mm)
    measured = measure_under_streaks(region, edge, radius_mm)
    if measured is None or not measured.evident:
        return judged
    again = replace(measured, contrast_hu=sphere.contrast_hu).with_doubts(_doubts(measured, region))
    return again if again.accepted else judged


def _doubts(sphere: Sphere, region: Region) -> tuple[Doubt, ...]:
    cleaned = sphere.cleaned if sphere.evident else None
    return shape_doubts(region, sphere.centre_mm, sphere.edge, sphere.stretch, cleaned=cleaned)


def _is_half_covered(edge: RadialEdge) -> bool:
    """Whether a sphere shows less than half its surface, but all that it can, with an edge under the rest.

    A cylinder or a bone has open sides that are on no sphere; the end of a rounded rod continues where a
    sphere would end.
    """
    return (
        edge.surface_share > COVERED_SURFACE_SHARE
        and edge.coherence > COVERED_COHERENCE
        and edge.covered_step_hu > COVERED_STEP_HU
        and edge.unscanned_share < UNSCANNED_FLAG
    )


def as_marker(sphere: Sphere, others: list[Sphere], volume: Volume, radius_mm: float) -> Marker:
    """Convert a sphere to a marker in patient coordinates, with quality and flags."""
    geometry = volume.geometry
    disagreement = sphere.agreement_mm / AGREEMENT_MM
    return Marker(
        centre_mm=geometry.grid_mm_to_patient_mm(sphere.centre_mm),
        covariance_mm2=geometry.covariance_to_patient(sphere.covariance_mm2),
        radius_mm=sphere.radius_mm,
        quality=sphere.edge.surface_share / (1.0 + disagreement**2),
        agreement_mm=sphere.agreement_mm,
        flags=_flags(sphere, others, radius_mm),
        odds=sphere.odds,
        shape_mm=None if sphere.stretch is None else sphere.stretch.terms_mm,
    )


def as_candidate(sphere: Sphere, volume: Volume) -> Candidate:
    """Return the verdict on a sphere, in patient coordinates."""
    return Candidate(
        centre_mm=_patient(volume, sphere.centre_mm),
        accepted=sphere.accepted,
        reason=sphere.reason,
        contrast_hu=sphere.contrast_hu,
        surface_share=sphere.edge.surface_share,
        radius_mm=sphere.radius_mm,
        odds=sphere.odds,
    )


def _flags(sphere: Sphere, others: list[Sphere], radius_mm: float) -> tuple[str, ...]:
    centre_mm = sphere.centre_mm
    distances_mm = [
        float(np.linalg.norm(centre_mm - other.centre_mm)) for other in others if other is not sphere
    ]
    raised = {
        ESTIMATORS_DISAGREE: sphere.agreement_mm > AGREEMENT_MM,
        CUT_BY_FIELD: sphere.edge.cut_share > CUT_FLAG,
        NEAR_METAL: sphere.metal_share > METAL_FLAG,
        SURFACE_HIDDEN: sphere.edge.surface_share < SURFACE_FLAG,
        RADIUS_UNUSUAL: abs(sphere.radius_mm - radius_mm) > RADIUS_FLAG * radius_mm,
        STREAKED: sphere.cleaned is not None,
        NEAR_ANOTHER: min(distances_mm, default=np.inf) < NEAR_ANOTHER_FLAG * 2.0 * radius_mm,
    }
    return tuple(word for word, is_raised in raised.items() if is_raised)


def _patient(volume: Volume, grid_mm: Array) -> tuple[float, float, float]:
    x, y, z = volume.geometry.grid_mm_to_patient_mm(grid_mm).tolist()
    return x, y, z
