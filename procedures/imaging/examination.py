"""Examination of a position in the scan: is there a surface of the right size, and is it a marker?"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from procedures.imaging.doubts import OVERLAP, assess_shape
from procedures.imaging.markers import (
    CUT_BY_FIELD,
    ESTIMATORS_DISAGREE,
    EVEN,
    NEAR_ANOTHER,
    NEAR_METAL,
    PICKED,
    RADIUS_UNUSUAL,
    STREAKED,
    SURFACE_HIDDEN,
    Candidate,
    Marker,
    MarkerDoubt,
    odds,
    reasons,
)
from procedures.imaging.sphere_centre.ball_model import Stretch, mark_metal_slices
from procedures.imaging.sphere_centre.blurred_ball import BlurredBall, fit_rough_ball
from procedures.imaging.sphere_centre.radial_edge import (
    RadialEdge,
    fit_radial_edge,
    is_polymer,
    ray_directions,
)
from procedures.imaging.sphere_centre.streaked_ball import fit_streaked_ball
from procedures.imaging.volume import Region, Volume, cut_region
from ronna_hw.arrays import Array

NOT_POLYMER = "shows no surface of a polymer sphere"
OVERLAPS = "overlaps a marker, as two spheres cannot"
REGION_REACH = 2.2  # of the radius
MIN_SURFACE_SHARE = 0.5
COVERED_SURFACE_SHARE = 0.35  # enough if what covers the rest shows an edge there
COVERED_COHERENCE = 0.85
SHADOWED_SURFACE_SHARE = 0.3  # enough to list a ball in the slices of metal, whose shadows hide the rest
COVERED_STEP_HU = 30.0  # a moist bandage is 50 to 100 HU below the polymer
RADIUS_TOLERANCE = 0.061  # of the radius: 0.35 mm for the usual sphere

CUT_FLAG = 0.005  # share of rays that leave the field before the sphere's edge: two of 400
METAL_FLAG = 0.17  # share of the surface near metal; a post takes 0.10 to 0.13
RADIUS_FLAG = 0.045  # of the radius: 0.26 mm
NEAR_ANOTHER_FLAG = 1.6  # distance between centres, in diameters

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
STREAKED_SHARE = 0.0075  # bend terms relative to the contrast: up to 0.004 without streaks
ENOUGH_SURFACE = 0.7  # for the edges to be used alone
UNSCANNED_FLAG = 0.02  # share of rays that leave the field
SURFACE_FLAG = 0.70  # share of the surface seen
STREAKED_AT_SIGHT = 0.12  # of the contrast: unevenness found by a robust fit; noise and posts stay below 0.08
MORE_SEEN = 0.1  # of the surface

IS_MARKER = "is a marker"


@dataclass(frozen=True, eq=False)
class Sphere:
    """Measured sphere in grid mm (slice, row, column), with any doubts about its being a marker.

    `agreement_mm` is the distance between both estimates of the centre, `metal_share` the part of the
    surface too close to metal to be used. `stretch` judges the body, `deformation`, with less noise, the
    scan; both are None if too little of the surface shows to determine them from the voxels. `cleaned` is
    the region without its streaks, if they had to be removed; `edge` is then the edge in it. `is_evident`
    says that streaks also show away from the edge; they may excuse its shape. `contrast_hu` is the
    detector's. A `picked` sphere counts as a marker despite its doubts.
    """

    edge: RadialEdge
    centre_mm: Array
    covariance_mm2: Array
    radius_mm: float
    agreement_mm: float
    metal_share: float
    stretch: Stretch | None
    deformation: Stretch | None
    cleaned: Region | None = None
    is_evident: bool = False
    contrast_hu: float = 0.0
    doubts: tuple[MarkerDoubt, ...] = ()
    picked: bool = False

    def with_doubts(self, doubts: Iterable[MarkerDoubt]) -> Sphere:
        """Return the sphere with additional doubts, which may push the odds below even."""
        return replace(self, doubts=(*self.doubts, *doubts))

    @property
    def odds(self) -> float:
        """Odds [0..1] that the sphere is a marker."""
        return odds(self.doubts)

    @property
    def accepted(self) -> bool:
        """Whether the sphere counts as a marker."""
        return self.picked or self.odds >= EVEN

    @property
    def reason(self) -> str:
        """Verdict in words for the candidate list."""
        return IS_MARKER if self.odds >= EVEN else f"is doubtful: {reasons(self.doubts)}"


def examine_place(
    volume: Volume,
    place_mm: Array,
    contrast_hu: float,
    radius_mm: float,
    known: list[Sphere],
    *,
    min_surface_share: float = MIN_SURFACE_SHARE,
) -> Sphere | Candidate:
    """Examine a position (3,) in grid mm; return a sphere, or the rejected candidate with the reason."""

    def reject(edge: RadialEdge | None, reason: str, likely: float = 0.0) -> Candidate:
        return Candidate(
            centre_mm=volume.patient_mm(edge.centre_mm if edge is not None else place_mm),
            accepted=False,
            reason=reason,
            contrast_hu=contrast_hu,
            surface_share=edge.surface_share if edge is not None else None,
            radius_mm=edge.radius_mm if edge is not None else None,
            odds=likely,
        )

    region = cut_region(volume, place_mm, REGION_REACH * radius_mm)
    edge = fit_radial_edge(region, place_mm, radius_mm)
    if edge is None:
        return reject(None, NOT_POLYMER)
    shows_little = edge.surface_share < min_surface_share and not _is_half_covered(edge)
    is_shadowed = edge.surface_share > SHADOWED_SURFACE_SHARE and mark_metal_slices(region).any()
    if shows_little and not is_shadowed:
        shows = "is cut off by the field of view, shows" if edge.cut_share > CUT_FLAG else "shows only"
        return reject(edge, f"{shows} {edge.surface_share:.0%} of a sphere's surface")
    if abs(edge.radius_mm - radius_mm) > RADIUS_TOLERANCE * radius_mm:
        return reject(edge, f"has radius {edge.radius_mm:.2f} mm instead of {radius_mm:.2f}")
    distances_mm = [float(np.linalg.norm(edge.centre_mm - other.centre_mm)) for other in known]
    nearest_mm = min(distances_mm, default=np.inf)
    if nearest_mm < radius_mm:
        return reject(edge, "is a marker that was already found")
    if nearest_mm < OVERLAP * 2.0 * radius_mm:
        return reject(edge, OVERLAPS)
    region = cut_region(volume, edge.centre_mm, REGION_REACH * radius_mm)
    refined = fit_radial_edge(region, edge.centre_mm, radius_mm, refine=True) or edge
    if shows_little:
        sphere = measure_under_streaks(region, refined, radius_mm)
        if sphere is None or not sphere.is_evident or sphere.edge.surface_share < min_surface_share:
            doubt = MarkerDoubt(
                f"shows only {edge.surface_share:.0%} of a sphere's surface in the slices of metal",
                min_surface_share / edge.surface_share,
            )
            return reject(edge, f"is doubtful: {doubt.reason}", odds([doubt]))
        return replace(sphere, contrast_hu=contrast_hu)
    sphere = measure_ball(region, refined, radius_mm)
    if sphere is None:
        return reject(refined, "fits no blurred sphere" if is_polymer(refined) else NOT_POLYMER)
    return replace(sphere, contrast_hu=contrast_hu)


def judge_shape(sphere: Sphere, volume: Volume, radius_mm: float) -> Sphere:
    """Return the sphere with doubts about its shape added.

    Streaks distort a shape: a doubtful sphere is judged again without its streaks, and accepted if that
    clears it.
    """
    edge = sphere.edge
    region = cut_region(volume, sphere.centre_mm, REGION_REACH * edge.radius_mm)
    judged = sphere.with_doubts(_assess_sphere(sphere, region))
    if judged.accepted or sphere.cleaned is not None:
        return judged
    region = cut_region(volume, edge.centre_mm, REGION_REACH * radius_mm)
    measured = measure_under_streaks(region, edge, radius_mm)
    if measured is None or not measured.is_evident:
        return judged
    rejudged = replace(measured, contrast_hu=sphere.contrast_hu).with_doubts(_assess_sphere(measured, region))
    return rejudged if rejudged.accepted else judged


def _assess_sphere(sphere: Sphere, region: Region) -> tuple[MarkerDoubt, ...]:
    cleaned = sphere.cleaned if sphere.is_evident else None
    return assess_shape(region, sphere.centre_mm, sphere.edge, sphere.stretch, cleaned=cleaned)


def _is_half_covered(edge: RadialEdge) -> bool:
    """Whether an underlying body with an edge hides up to half of the sphere and the rest is fully visible.

    A cylinder or a bone has open sides that are on no sphere; the end of a rounded rod continues where a
    sphere would end.
    """
    return (
        edge.surface_share > COVERED_SURFACE_SHARE
        and edge.coherence > COVERED_COHERENCE
        and edge.covered_step_hu > COVERED_STEP_HU
        and edge.unscanned_share < UNSCANNED_FLAG
    )


def as_marker(
    sphere: Sphere, others: list[Sphere], volume: Volume, radius_mm: float, overlaps: Sequence[Candidate] = ()
) -> Marker:
    """Convert a sphere to a marker in patient coordinates, with quality and flags.

    `overlaps` are rejected candidates that overlap a marker.
    """
    centre_mm = volume.patient_mm(sphere.centre_mm)
    apart_mm = [float(np.linalg.norm(np.subtract(centre_mm, other.centre_mm))) for other in overlaps]
    is_overlapped = min(apart_mm, default=np.inf) < 2.0 * radius_mm
    return Marker(
        centre_mm=centre_mm,
        covariance_mm2=volume.geometry.covariance_to_patient(sphere.covariance_mm2).tolist(),
        radius_mm=sphere.radius_mm,
        quality=sphere.edge.surface_share / (1.0 + (sphere.agreement_mm / AGREEMENT_MM) ** 2),
        agreement_mm=sphere.agreement_mm,
        flags=_list_flags(sphere, others, radius_mm, is_overlapped=is_overlapped),
        odds=sphere.odds,
    )


def as_candidate(sphere: Sphere, volume: Volume) -> Candidate:
    """Convert a sphere to a candidate with its verdict, in patient coordinates."""
    return Candidate(
        centre_mm=volume.patient_mm(sphere.centre_mm),
        accepted=sphere.accepted,
        reason=sphere.reason,
        contrast_hu=sphere.contrast_hu,
        surface_share=sphere.edge.surface_share,
        radius_mm=sphere.radius_mm,
        odds=sphere.odds,
    )


def _list_flags(
    sphere: Sphere, others: list[Sphere], radius_mm: float, *, is_overlapped: bool
) -> tuple[str, ...]:
    distances_mm = [
        float(np.linalg.norm(sphere.centre_mm - other.centre_mm)) for other in others if other is not sphere
    ]
    raised = {
        ESTIMATORS_DISAGREE: sphere.agreement_mm > AGREEMENT_MM,
        CUT_BY_FIELD: sphere.edge.cut_share > CUT_FLAG,
        NEAR_METAL: sphere.metal_share > METAL_FLAG,
        SURFACE_HIDDEN: sphere.edge.surface_share < SURFACE_FLAG,
        RADIUS_UNUSUAL: abs(sphere.radius_mm - radius_mm) > RADIUS_FLAG * radius_mm,
        STREAKED: sphere.cleaned is not None,
        NEAR_ANOTHER: is_overlapped
        or min(distances_mm, default=np.inf) < NEAR_ANOTHER_FLAG * 2.0 * radius_mm,
        PICKED: sphere.picked,
    }
    return tuple(word for word, is_raised in raised.items() if is_raised)


def measure_ball(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Sphere | None:
    """Measure the sphere whose surface is `edge`; return None if no ball fits.

    A level that no polymer has is possible only if there are streaks to explain it.
    """
    if not is_polymer(edge):
        under_streaks = measure_under_streaks(region, edge, nominal_radius_mm)
        return under_streaks if under_streaks is not None and under_streaks.is_evident else None
    hidden = edge.surface_share < SURFACE_FLAG and edge.unscanned_share < UNSCANNED_FLAG
    unseen = ray_directions()[~edge.seen]
    rough = fit_rough_ball(region, edge, hidden_directions=unseen if hidden else None)
    if rough is None:
        return measure_under_streaks(region, edge, nominal_radius_mm)
    if hidden:
        ball = rough.refined(unseen)
        if ball is None:
            return None
        return replace(combine_estimates(edge, ball, region.spacing_mm), stretch=None, deformation=None)
    under_streaks = None
    if rough.background_unevenness > STREAKED_AT_SIGHT or mark_metal_slices(region).any():
        under_streaks = measure_under_streaks(region, edge, nominal_radius_mm)
        if under_streaks is not None and under_streaks.is_evident:
            return under_streaks
    ball = rough.refined(unseen, most_streaks=STREAKED_SHARE)
    if ball is None or _is_streaked(edge, ball):
        under_streaks = under_streaks or measure_under_streaks(region, edge, nominal_radius_mm)
        if under_streaks is not None:
            return under_streaks
        ball = ball or rough.refined(unseen)
    return None if ball is None else combine_estimates(edge, ball, region.spacing_mm)


def measure_under_streaks(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Sphere | None:
    """Measure the sphere jointly with the streaks in each slice.

    Streaks hide directions from the rays. Those that show once they are removed are used in a second fit.
    """
    first = _measure_with_streaks(region, edge, nominal_radius_mm)
    if first is None or first.edge.surface_share < edge.surface_share + MORE_SEEN:
        return first
    return _measure_with_streaks(region, first.edge, nominal_radius_mm) or first


def _measure_with_streaks(region: Region, edge: RadialEdge, nominal_radius_mm: float) -> Sphere | None:
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
        deformation=ball.stretch,
        cleaned=ball.cleaned,
        is_evident=ball.is_evident,
    )


def combine_estimates(edge: RadialEdge, ball: BlurredBall, spacing_mm: Array) -> Sphere:
    """Combine both centre estimates, or use the edge alone where streaks have spoiled the ball fit."""
    if _is_spoiled(edge, ball):
        centre_mm, radius_mm = edge.centre_mm, edge.radius_mm
        streaks = ball.streak_hu / abs(edge.inside_hu - edge.outside_hu)
        covariance = _edge_covariance(edge, spacing_mm, streaks)
    else:
        (centre_mm, covariance), radius_mm = _weighted_mean(edge, ball, spacing_mm), ball.radius_mm
    return Sphere(
        edge=edge,
        centre_mm=centre_mm,
        covariance_mm2=0.5 * (covariance + covariance.T),
        radius_mm=radius_mm,
        agreement_mm=float(np.linalg.norm(edge.centre_mm - ball.centre_mm)),
        metal_share=ball.metal_share,
        stretch=ball.stretch,
        deformation=ball.deformation,
    )


def _weighted_mean(edge: RadialEdge, ball: BlurredBall, spacing_mm: Array) -> tuple[Array, Array]:
    """Return the minimum-variance mean of both centres (generalized least squares) and its covariance."""
    first = _edge_covariance(edge, spacing_mm, ball.streak_hu / abs(ball.contrast_hu))
    second = ball.covariance_mm2 + np.diag((SLICE_PROFILE_ERROR_PER_MM * spacing_mm**2) ** 2)
    # an estimate that adds no information gets zero weight rather than a negative one
    correlation = min(ERROR_CORRELATION, float(np.sqrt(np.trace(second) / np.trace(first))))
    cross = correlation * _matrix_root(first) @ _matrix_root(second)
    difference = edge.centre_mm - ball.centre_mm
    spread = first + second - cross - cross.T  # covariance of the difference
    gain = (second - cross.T) @ np.linalg.inv(spread)
    centre_mm = ball.centre_mm + gain @ difference
    covariance = second - gain @ (second - cross)
    excess = max(0.0, float(difference @ difference) - float(np.trace(spread)))
    if excess > 0.0:
        direction = difference / np.linalg.norm(difference)
        covariance = covariance + 0.0625 * excess * (np.outer(direction, direction) + np.eye(3))
    return centre_mm, covariance


def _is_streaked(edge: RadialEdge, ball: BlurredBall) -> bool:
    """Whether streaks bend the background too much to trust the covariance of either fit."""
    apart_mm = float(np.linalg.norm(edge.centre_mm - ball.centre_mm))
    is_bent = ball.streak_hu > STREAKED_SHARE * abs(ball.contrast_hu)
    return is_bent or apart_mm > AGREEMENT_MM or _is_spoiled(edge, ball)


def _is_spoiled(edge: RadialEdge, ball: BlurredBall) -> bool:
    low, high = RADIUS_ABOVE_EDGES
    radius_excess = ball.radius_mm / edge.radius_mm - 1.0
    return edge.surface_share >= ENOUGH_SURFACE and not low < radius_excess < high


def _edge_covariance(edge: RadialEdge, spacing_mm: Array, streaks: float) -> Array:
    """Return the covariance of the edge's centre; `streaks` is background bend relative to contrast."""
    interpolation = np.diag((INTERPOLATION_ERROR_PER_MM * spacing_mm**2) ** 2)
    streaks_mm = EDGE_STREAK_ERROR_MM * streaks
    return RAY_CORRELATION * edge.covariance_mm2 + interpolation + streaks_mm**2 / 3.0 * np.eye(3)


def _matrix_root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
