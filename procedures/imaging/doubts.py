"""Doubts about whether a fitted sphere is a marker, based on its shape, neighbours and size.

A fitted sphere rests on the part of a surface that fits; an egg, a rod with a round end or a cap also have
such a part. Here every ray counts. Mask into metal carry no information. Mask that end in something denser
than the surroundings must cross an edge at the sphere's radius, as under skin or a bandage; a post is too
narrow to matter. All other rays must leave the sphere where it ends.

Neighbours count, too: two whole spheres do not overlap, markers are not lined up like beads, and the markers
of one scan are one product of one size.
"""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.markers import MarkerDoubt
from procedures.imaging.sphere_centre.ball_model import (
    METAL_HU,
    Stretch,
    mark_metal_slices,
    stretch_matrix,
    stretch_terms,
)
from procedures.imaging.sphere_centre.radial_edge import (
    INLIER,
    OUTSIDE_FROM,
    SAME_LEVEL,
    STEP_INSIDE,
    STEP_OUTSIDE,
    RadialEdge,
    ray_directions,
)
from procedures.imaging.volume import Region
from ronna_hw.arrays import Array, Mask

Span = tuple[float, float]

# radii as multiples of the fitted one
OUTERMOST, STEPS = 1.6, 65
CORE, INNER_CORE = 0.72, 0.5  # a post ends at 0.74
MIDDLE, BEFORE_SURFACE = (0.2, 0.5), (0.65, 0.85)
METAL_FROM = 0.6

NEIGHBOURS = 16  # rays, as many as hit a rod of 2.8 mm radius: fewer than half of them hit a post
RIM_COSINE = np.cos(0.3)  # rays this close to a cover or to metal show its rim
EXTENT_CLIP = 0.2  # of the radius: an edge farther away does not count towards the extent
EXTENT_PRIOR = 2.0  # rays by which the extents are shrunk towards equality when few are visible

# Limits at even odds. Markers of the tuning families stay below half of each; objects of `rounded` and
# `joined` exceed at least one by half.
AMISS_SHARE = 0.04  # of the surface, that is off the sphere
AMISS_UNDER_STREAKS = 0.06  # chosen on three to six bands of 200 to 500 HU across `bands`
# limits for a whole body where metal in the same slices throws streaks; the usual ones then count for what
# is in other slices
AMISS_UNDER_SHADOWS = 0.12
HOLLOW_UNDER_SHADOWS, THROUGH_SHADOWS = 0.27, 0.4  # a hollow ball with a wall of 3 mm: 0.29
WALL = (0.80, 0.92)  # of the radius
BORDER_HU = 20.0  # fall at the surface, where it is smallest; to a moist bandage it is 40 HU
NARROW_SHARE = 0.15  # of the surface: air around a narrow cover increases the fall next to it
NARROW_BORDER_HU = 50.0
LEAST_BORDER_HU = 5.0  # stands for none
EXTENT_DIFFERENCE = 0.06  # of the radius: between the longest and the shortest semi-axis, measured by rays
STRETCH = 0.023  # the same, measured by voxels: 0.13 mm; a capsule 0.28 mm longer than wide reaches it
STRETCH_DEVIATIONS = 5.0  # plus this many standard deviations of the noise
MOST_SHIFTED = 0.15  # of the contrast: shift of a ray's level by streaks; anything attached raises it by half
NOT_BY_STREAKS = (1, 2)  # doubts that streaks do not raise: something attached, an end under a cover
METAL_DOUBT = 5  # the last one: metal shines in the image with its streaks and in that without
HOLLOW_SHARE = 0.08  # of the core; 0.02 in markers under strong streaks
METAL_CORE_SHARE = 0.015  # of the rays' length through the inner core
EARLY_FALL_HU = 16.0  # under a cover, before the surface: domes on skin show 36 and more, markers 8 at most

OVERLAP = 0.95  # of the diameter: the centres of two spheres cannot be closer
IN_A_ROW = 1.5  # of the diameter: bodies farther apart do not form a row
STRAIGHT_COSINE = -np.cos(np.radians(15.0))  # between the directions to the two neighbours
EVEN_SPACING = 0.15  # of the spacing
FEWEST_ALIKE = 3  # markers needed to establish the usual size
RADIUS_DIFFERENCE = 0.035  # of the radius, at even odds: 0.2 mm
CERTAIN = 3.0  # excess of an impossibility


def assess_shape(
    region: Region,
    centre_mm: Array,
    edge: RadialEdge,
    stretch: Stretch | None,
    *,
    cleaned: Region | None = None,
) -> tuple[MarkerDoubt, ...]:
    """Quantify each way in which a body may differ from a whole sphere.

    `edge` is a sphere fitted to its surface; `centre_mm` grid mm. `stretch` comes from the voxels if they
    determine it; otherwise rays do, which streaks and covers disturb more. `cleaned` is the region without
    its streaks: they bend a surface and darken a core, but neither attach anything to a sphere nor cut it
    off.
    """
    if cleaned is None:
        return _judge_region(region, centre_mm, edge, stretch)
    cleaned_doubts, streaked_doubts = (
        _judge_region(one, centre_mm, edge, stretch, streaked=True) for one in (cleaned, region)
    )
    return tuple(
        max(pair, key=lambda doubt: doubt.excess)
        if number in NOT_BY_STREAKS
        else min(pair, key=lambda doubt: doubt.excess)
        if number == METAL_DOUBT
        else pair[0]
        for number, pair in enumerate(zip(cleaned_doubts, streaked_doubts, strict=True))
    )


def _judge_region(
    region: Region, centre_mm: Array, edge: RadialEdge, stretch: Stretch | None, *, streaked: bool = False
) -> tuple[MarkerDoubt, ...]:
    """Judge one region. If `streaked`, the edge is sought midway between each ray's own levels."""
    shares = np.linspace(0.0, OUTERMOST, STEPS)
    directions = ray_directions()
    profiles = region.sample(
        centre_mm + edge.radius_mm * shares[None, :, None] * directions[:, None, :], smooth=True
    )
    shadowed = np.zeros(profiles.shape, dtype=bool)
    if streaked:
        heights = (centre_mm[0] + edge.radius_mm * shares[None] * directions[:, :1]) / region.spacing_mm[0]
        slices = np.rint(heights).astype(int) - int(region.start[0])
        shadowed = mark_metal_slices(region)[np.clip(slices, 0, region.values.shape[0] - 1)]
    scanned = np.isfinite(profiles[:, shares <= OUTSIDE_FROM]).all(axis=1)
    profiles = np.where(np.isfinite(profiles), profiles, edge.outside_hu)
    metal = (profiles[:, shares > METAL_FROM] > METAL_HU).any(axis=1)
    informative = np.asarray(scanned & ~metal)
    levels_hu = np.full(len(directions), 0.5 * (edge.inside_hu + edge.outside_hu))
    if streaked:
        levels_hu += _level_shifts_hu(profiles, shares, edge)
    place, is_crossed = _first_fall(profiles, shares, levels_hu)
    opens = informative & is_crossed
    covered = informative & ~is_crossed
    fall_hu = np.subtract(*_levels_hu(profiles, shares, STEP_INSIDE, STEP_OUTSIDE))
    border_hu = _median_around(fall_hu, informative)
    early_hu = 0.0
    if covered.sum() > NEIGHBOURS:  # more than a post
        middle, before = _levels_hu(profiles, shares, MIDDLE, BEFORE_SURFACE)
        early_hu = max(float((middle - before)[covered].mean()), 0.0)
    limit_hu = BORDER_HU if covered.mean() > NARROW_SHARE else NARROW_BORDER_HU
    joined = covered & (border_hu < limit_hu)
    # at the rim of a cover or of metal the edge belongs to that
    clear = opens & ~_mark_adjacent_rays(directions, (covered & ~joined) | metal)
    off_sphere = clear & (np.abs(place - 1.0) > INLIER)
    amiss = off_sphere.mean() / (AMISS_UNDER_STREAKS if streaked else AMISS_SHARE)
    if shadowed.any():
        at_surface = shadowed[:, int(np.argmin(np.abs(shares - 1.0)))]
        lit_amiss = (off_sphere & ~at_surface).mean() / AMISS_UNDER_STREAKS
        amiss = max(lit_amiss, off_sphere.mean() / AMISS_UNDER_SHADOWS)
    if stretch is None:
        difference_mm = edge.radius_mm * _extent_difference(directions[clear], place[clear] - 1.0)
        elongation = difference_mm / (EXTENT_DIFFERENCE * edge.radius_mm)
    else:
        difference_mm = stretch.difference_mm
        limit_mm = np.hypot(STRETCH * edge.radius_mm, STRETCH_DEVIATIONS * stretch.deviation_mm)
        elongation = difference_mm / float(limit_mm)
    odd = np.abs(profiles - edge.inside_hu) > SAME_LEVEL * abs(edge.inside_hu - edge.outside_hu)
    core, inner = shares < CORE, shares < INNER_CORE
    volume = shares[core] ** 2
    all_of_it = informative.sum() * volume.sum()
    different = odd[informative][:, core]
    hollow = float((different @ volume).sum() / all_of_it) if informative.any() else 1.0
    hollow_excess = hollow / (THROUGH_SHADOWS if shadowed.any() else HOLLOW_SHARE)
    if shadowed.any() and informative.any():
        lit = different & ~shadowed[informative][:, core]
        # a shadow enters through the surface, a hollow has a wall
        (wall_hu,) = _levels_hu(profiles[informative], shares, WALL)
        walled = np.abs(wall_hu - edge.inside_hu) < SAME_LEVEL * abs(edge.inside_hu - edge.outside_hu)
        for one, limit in ((lit, HOLLOW_SHARE), (different & walled[:, None], HOLLOW_UNDER_SHADOWS)):
            hollow_excess = max(hollow_excess, float((one @ volume).sum() / all_of_it) / limit)
    metal_core = float((profiles[:, inner] > METAL_HU).mean())
    return (
        MarkerDoubt(f"{off_sphere.mean():.0%} of its surface is off a sphere", amiss),
        MarkerDoubt("extends beyond a sphere", limit_hu / max(float(border_hu.min()), LEAST_BORDER_HU)),
        MarkerDoubt("ends under its cover before a sphere would", early_hu / EARLY_FALL_HU),
        MarkerDoubt(f"is {difference_mm:.2f} mm longer in one direction than in another", elongation),
        MarkerDoubt(f"{hollow:.0%} of its core is a different material", hollow_excess),
        MarkerDoubt("has metal in its core", metal_core / METAL_CORE_SHARE),
    )


def _level_shifts_hu(profiles: Array, shares: Array, edge: RadialEdge) -> Array:
    """Return each ray's level shift (rays,) in HU relative to the sphere's usual levels, clipped."""
    near, far = _levels_hu(profiles, shares, STEP_INSIDE, STEP_OUTSIDE)
    most_hu = MOST_SHIFTED * abs(edge.inside_hu - edge.outside_hu)
    return np.asarray(np.clip(0.5 * (near + far - edge.inside_hu - edge.outside_hu), -most_hu, most_hu))


def _first_fall(profiles: Array, shares: Array, levels_hu: Array) -> tuple[Array, Mask]:
    """Return the radius, in sphere radii, at which each ray first falls below its level, and whether it does.

    The edge of a ray that is below its level throughout is at the core.
    """
    searched = (shares >= CORE) & (shares <= OUTSIDE_FROM)
    values, places = profiles[:, searched], shares[searched]
    above = values >= levels_hu[:, None]
    falls = above[:, :-1] & ~above[:, 1:]
    first, rows = falls.argmax(axis=1), np.arange(len(values))
    before, after = values[rows, first], values[rows, first + 1]
    drop = np.where(before > after, before - after, 1.0)
    place = places[first] + np.clip((before - levels_hu) / drop, 0.0, 1.0) * (places[1] - places[0])
    return np.where(falls.any(axis=1), place, CORE), np.asarray(~above.all(axis=1))


def _levels_hu(profiles: Array, shares: Array, *spans: Span) -> list[Array]:
    """Return each ray's mean intensity over spans of radii, in HU."""
    return [profiles[:, (shares > low) & (shares < high)].mean(axis=1) for low, high in spans]


def _median_around(values: Array, informative: Mask) -> Array:
    """Return the median over each ray's neighbours, (rays,); infinite if half of them are uninformative."""
    return np.asarray(np.median(np.where(informative, values, np.inf)[_neighbours()], axis=1))


@cache
def _neighbours() -> NDArray[np.intp]:
    """Return the indices of each ray's nearest rays, including itself, (rays, NEIGHBOURS)."""
    directions = ray_directions()
    return np.argpartition(-(directions @ directions.T), NEIGHBOURS, axis=1)[:, :NEIGHBOURS]


def _mark_adjacent_rays(directions: Array, rays: Mask) -> Mask:
    if not rays.any():
        return np.zeros(len(directions), dtype=bool)
    return np.asarray((directions @ directions[rays].T > RIM_COSINE).any(axis=1))


def _extent_difference(directions: Array, offsets: Array) -> float:
    """Estimate longest minus shortest semi-axis, in radii, from offsets (n,) along directions (n, 3).

    The offsets are modelled as those of a shifted, scaled and stretched sphere. If few rays are visible, the
    stretch is shrunk towards zero.
    """
    usable = np.abs(offsets) < EXTENT_CLIP
    seen = directions[usable]
    design = np.column_stack([np.ones(len(seen)), seen, stretch_terms(seen)])
    ridge = np.diag([1e-6] * 4 + [EXTENT_PRIOR] * 5)
    terms = np.linalg.solve(design.T @ design + ridge, design.T @ offsets[usable])[4:]
    return float(np.ptp(np.linalg.eigvalsh(stretch_matrix(terms))))


def assess_neighbours(
    centres_mm: Array, others_mm: Array, diameter_mm: float
) -> list[tuple[MarkerDoubt, ...]]:
    """List doubts about spheres at `centres_mm` (n, 3) near bodies of equal size at `others_mm` (m, 3)."""
    bodies = np.vstack([centres_mm.reshape(-1, 3), others_mm.reshape(-1, 3)])
    offsets = bodies[None] - bodies[:, None]
    distances = np.linalg.norm(offsets, axis=2)
    np.fill_diagonal(distances, np.inf)
    row_members = _find_rows(offsets, distances, diameter_mm)
    doubts: list[tuple[MarkerDoubt, ...]] = []
    for number in range(len(centres_mm)):
        raised = {
            "overlaps another body of its size": distances[number].min(initial=np.inf)
            < OVERLAP * diameter_mm,
            "is one of a row": number in row_members,
        }
        doubts.append(tuple(MarkerDoubt(words, CERTAIN) for words, is_raised in raised.items() if is_raised))
    return doubts


def assess_sizes(radii_mm: Array, clear: Mask) -> list[MarkerDoubt]:
    """List a doubt for each radius (n,), from its deviation from the median radius of clear spheres."""
    if clear.sum() < FEWEST_ALIKE:
        return [MarkerDoubt("", 0.0)] * len(radii_mm)
    usual_mm = float(np.median(radii_mm[clear]))
    return [
        MarkerDoubt(
            f"has radius {radius_mm:.2f} mm, the others {usual_mm:.2f}",
            abs(radius_mm - usual_mm) / (RADIUS_DIFFERENCE * usual_mm),
        )
        for radius_mm in radii_mm.tolist()
    ]


def _find_rows(offsets: Array, distances: Array, diameter_mm: float) -> set[int]:
    """Find bodies that form a straight, close and evenly spaced row of three."""
    near = distances < IN_A_ROW * diameter_mm
    row_members: set[int] = set()
    for middle in np.flatnonzero(near.sum(axis=1) >= 2).tolist():
        for one, other in permutations(np.flatnonzero(near[middle]).tolist(), 2):
            lengths = distances[middle, [one, other]]
            straight = offsets[middle, one] @ offsets[middle, other] < STRAIGHT_COSINE * lengths.prod()
            if straight and np.ptp(lengths) < EVEN_SPACING * lengths.max():
                row_members |= {one, middle, other}
    return row_members
