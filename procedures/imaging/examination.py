"""Decides whether a candidate is a marker: finds its surface, checks its size, runs both estimators."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.company import OVERLAP
from procedures.imaging.detection import Peak
from procedures.imaging.doubts import EVEN, Doubt, odds, reasons
from procedures.imaging.markers import (
    CUT_BY_FIELD,
    ESTIMATORS_DISAGREE,
    NEAR_ANOTHER,
    NEAR_METAL,
    RADIUS_UNUSUAL,
    STREAKED,
    SURFACE_HIDDEN,
    Candidate,
    Marker,
)
from procedures.imaging.measurement import (
    SURFACE_FLAG,
    UNSCANNED_FLAG,
    Measured,
    measure,
    measure_under_streaks,
)
from procedures.imaging.region import Region, cut_region
from procedures.imaging.sphere_centre.combination import AGREEMENT_MM, CombinedCentre
from procedures.imaging.sphere_centre.radial_edge import RadialEdge, fit_radial_edge, is_polymer
from procedures.imaging.volume import Volume
from procedures.imaging.whole_sphere import shape_doubts

Array = NDArray[np.float64]

IS_MARKER = "is a marker"
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


@dataclass(frozen=True, eq=False)
class Sphere:
    """A fitted sphere, in grid mm (slice, row, column), and the doubts that it is a marker."""

    candidate: Candidate
    measured: Measured
    doubts: tuple[Doubt, ...]

    @property
    def combined(self) -> CombinedCentre:
        """The combined centre of both estimators."""
        return self.measured.combined

    def doubted(self, doubts: Iterable[Doubt]) -> Sphere:
        """The same with further doubts, which may push the odds below even."""
        together = (*self.doubts, *doubts)
        left = odds(together)
        accepted = left >= EVEN
        reason = IS_MARKER if accepted else f"is doubtful: {reasons(together)}"
        candidate = replace(self.candidate, accepted=accepted, reason=reason, odds=left)
        return replace(self, candidate=candidate, doubts=together)

    def picked(self) -> Sphere:
        """The same as a marker, whatever the doubts: a person said so."""
        return replace(self, candidate=replace(self.candidate, accepted=True))


def examine(
    volume: Volume,
    peak: Peak,
    radius_mm: float,
    known: list[Sphere],
    *,
    min_surface_share: float = MIN_SURFACE_SHARE,
) -> Sphere | Candidate:
    """A sphere, or the candidate with the reason why it is not one."""
    region = cut_region(volume, peak.position_mm, REGION_REACH * radius_mm)
    edge = fit_radial_edge(region, peak.position_mm, radius_mm)
    if edge is None:
        return _rejected(volume, peak, None, NOT_POLYMER)
    if edge.surface_share < min_surface_share and not _is_half_covered(edge):
        seen = f"{edge.surface_share:.0%} of a sphere's surface"
        cut = edge.cut_share > CUT_FLAG
        return _rejected(
            volume,
            peak,
            edge,
            f"is cut off by the field of view, shows {seen}" if cut else f"shows only {seen}",
        )
    if abs(edge.radius_mm - radius_mm) > RADIUS_TOLERANCE * radius_mm:
        return _rejected(volume, peak, edge, f"has radius {edge.radius_mm:.2f} mm instead of {radius_mm:.2f}")
    distances_mm = [float(np.linalg.norm(edge.centre_mm - other.combined.centre_mm)) for other in known]
    if min(distances_mm, default=np.inf) < radius_mm:
        return _rejected(volume, peak, edge, "is a marker that was already found")
    if min(distances_mm, default=np.inf) < OVERLAP * 2.0 * radius_mm:
        return _rejected(volume, peak, edge, OVERLAPS)
    region = cut_region(volume, edge.centre_mm, REGION_REACH * radius_mm)
    refined = fit_radial_edge(region, edge.centre_mm, radius_mm, refine=True) or edge
    measured = measure(region, refined, radius_mm)
    if measured is None:
        reason = "fits no blurred sphere" if is_polymer(refined) else NOT_POLYMER
        return _rejected(volume, peak, refined, reason)
    return _sphere(volume, measured, peak.contrast_hu)


def with_shape(sphere: Sphere, volume: Volume, radius_mm: float) -> Sphere:
    """The sphere with doubts about its shape.

    Streaks distort a shape: a doubtful one is judged again with the streaks removed, and
    accepted if that clears it.
    """
    edge = sphere.measured.edge
    region = cut_region(volume, sphere.combined.centre_mm, REGION_REACH * edge.radius_mm)
    judged = sphere.doubted(_doubts(sphere.measured, region))
    if judged.candidate.accepted or sphere.measured.cleaned is not None:
        return judged
    region = cut_region(volume, edge.centre_mm, REGION_REACH * radius_mm)
    measured = measure_under_streaks(region, edge, radius_mm)
    if measured is None or not measured.evident:
        return judged
    again = _sphere(volume, measured, sphere.candidate.contrast_hu).doubted(_doubts(measured, region))
    return again if again.candidate.accepted else judged


def _doubts(measured: Measured, region: Region) -> tuple[Doubt, ...]:
    centre_mm, edge = measured.combined.centre_mm, measured.edge
    cleaned = measured.cleaned if measured.evident else None
    return shape_doubts(region, centre_mm, edge, measured.stretch, cleaned=cleaned)


def _sphere(volume: Volume, measured: Measured, contrast_hu: float) -> Sphere:
    candidate = Candidate(
        centre_mm=_patient(volume, measured.combined.centre_mm),
        accepted=True,
        reason=IS_MARKER,
        contrast_hu=contrast_hu,
        surface_share=measured.edge.surface_share,
        radius_mm=measured.combined.radius_mm,
        odds=1.0,
    )
    return Sphere(candidate, measured, ())


def _is_half_covered(edge: RadialEdge) -> bool:
    """Does less than half of the surface show, but all that can, with an edge under the rest?

    A cylinder or a bone has open sides that are on no sphere; the end of a rounded rod continues where
    the sphere should end.
    """
    return (
        edge.surface_share > COVERED_SURFACE_SHARE
        and edge.coherence > COVERED_COHERENCE
        and edge.covered_step_hu > COVERED_STEP_HU
        and edge.unscanned_share < UNSCANNED_FLAG
    )


def as_marker(sphere: Sphere, others: list[Sphere], volume: Volume, radius_mm: float) -> Marker:
    """A sphere as a marker in patient coordinates, with quality and flags."""
    geometry = volume.geometry
    combined = sphere.combined
    disagreement = combined.agreement_mm / AGREEMENT_MM
    return Marker(
        centre_mm=geometry.grid_mm_to_patient_mm(combined.centre_mm),
        covariance_mm2=geometry.covariance_to_patient(combined.covariance_mm2),
        radius_mm=sphere.combined.radius_mm,
        quality=sphere.measured.edge.surface_share / (1.0 + disagreement**2),
        agreement_mm=combined.agreement_mm,
        flags=_flags(sphere, others, radius_mm),
        odds=sphere.candidate.odds,
        shape_mm=None if sphere.measured.stretch is None else sphere.measured.stretch.terms_mm,
    )


def _flags(sphere: Sphere, others: list[Sphere], radius_mm: float) -> tuple[str, ...]:
    centre_mm = sphere.combined.centre_mm
    distances_mm = [
        float(np.linalg.norm(centre_mm - other.combined.centre_mm)) for other in others if other is not sphere
    ]
    raised = {
        ESTIMATORS_DISAGREE: sphere.combined.agreement_mm > AGREEMENT_MM,
        CUT_BY_FIELD: sphere.measured.edge.cut_share > CUT_FLAG,
        NEAR_METAL: sphere.measured.metal_share > METAL_FLAG,
        SURFACE_HIDDEN: sphere.measured.edge.surface_share < SURFACE_FLAG,
        RADIUS_UNUSUAL: abs(sphere.combined.radius_mm - radius_mm) > RADIUS_FLAG * radius_mm,
        STREAKED: sphere.measured.cleaned is not None,
        NEAR_ANOTHER: min(distances_mm, default=np.inf) < NEAR_ANOTHER_FLAG * 2.0 * radius_mm,
    }
    return tuple(word for word, is_raised in raised.items() if is_raised)


def _rejected(volume: Volume, peak: Peak, edge: RadialEdge | None, reason: str) -> Candidate:
    return Candidate(
        centre_mm=_patient(volume, edge.centre_mm if edge is not None else peak.position_mm),
        accepted=False,
        reason=reason,
        contrast_hu=peak.contrast_hu,
        surface_share=edge.surface_share if edge is not None else None,
        radius_mm=edge.radius_mm if edge is not None else None,
    )


def _patient(volume: Volume, grid_mm: Array) -> tuple[float, float, float]:
    x, y, z = volume.geometry.grid_mm_to_patient_mm(grid_mm).tolist()
    return x, y, z
