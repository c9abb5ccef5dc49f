"""Marker placement on a head for the smallest error at the targets, or for distinct distances.

Markers serve a target best if their centroid is near it and they are far from the principal axes through it:
eq. 39. For comparison, freehand choices are drawn at random over the same skin. The arm's own errors, which
depend on the pose of the head, are not included. For three or four markers, the thesis advises a template
whose distances all differ by a margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.planning.errors import NO_MARKER_SITES, NO_TEMPLATE
from procedures.planning.head_in_ct import AIR_BELOW_HU, HeadEllipsoid, ring_around, sample_head, sample_hu
from procedures.registration.error_theory import tre_principal_axes_mm
from procedures.registration.surface.regions import HeadAxes
from procedures.strategies.trajectory import Trajectory, split_along
from ronna_hw.arrays import Array, Mask
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.marker_template import MarkerTemplate, TemplateMarker
from ronna_hw.records import write_atomically
from ronna_hw.vectors import vector3

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

CAP_AXIS = (0.0, -1.0, 1.0)  # LPS, from forehead to vertex: excludes pillow and face
CAP_HALF_ANGLE_RAD = np.radians(50.0)
# Parts of a head with a bone to hold a screw under thin skin, which a sphere hides no eye or ear on.
CRANIUM = ("vault", "forehead", "left temple", "right temple", "occiput")
STANDOFF_MM = 16.0  # from the skin to a sphere's centre: base and half a sphere
APART_MM = 38.0  # between two markers, so that the stereo head sees one at a time
SITES, TEMPLATE_DRAWS = 600, 60_000
SKIN_STEP_MM = 0.5
SKIN_MM = (25.0, -40.0)  # range searched for skin: outside the ellipsoid, inside it
RING_MM = 14.0  # from a site to the points around it: a sphere, post or bolt covers few of them
FREE_SKIN_MM = 4.0  # a site is no higher and no lower than these
SKIN_THICK_MM = 4.0  # anything thinner is a sheet or a cable
FEWEST, MOST = 3, 8
CLEAR_OF_PATH_MM = 30.0  # of a marker's centre from a trajectory: the guide's radius, a sphere, a margin
DIFFER_MM = 6.0  # between the distances of three or four markers, which might otherwise be confused
DISTINCT_BY_NUMBER = 5
DRAWS = 20_000  # random sets tried first, representing freehand choices
USUAL = 50.0  # per cent of them are better
MOST_ROUNDS = 20  # of exchanges; three to five is usual


class ExpectedError(Strict):
    """Expected error at one target."""

    target: str = Field(description="Trajectory of the plan.")
    expected_mm: float = Field(description="Rms error with the proposed markers.")
    usual_mm: float = Field(description="Median with markers placed at random over the same skin.")


class ProposedMarkers(Strict):
    """Proposed marker positions, and the expected error at each target."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = Field(
        default=1, description="Version of this form."
    )
    markers: tuple[TemplateMarker, ...] = Field(description="In no particular order.")
    marker_error_mm: float = Field(
        description="Assumed error of each marker, 3-D rms: CT, seating, stereo head."
    )
    targets: tuple[ExpectedError, ...] = Field(description="Targets of the plan.")

    @property
    def centres_mm(self) -> tuple[Numbers3, ...]:
        """Centres of the spheres, LPS."""
        return tuple(one.centre_mm for one in self.markers)


@dataclass(frozen=True)
class FurtherMarker:
    """Best position for one more marker, with the rms error at each target before and after, in mm."""

    centre_mm: Numbers3
    targets: tuple[tuple[str, float, float], ...]


def propose_markers(
    head: HeadEllipsoid,
    trajectories: Sequence[Trajectory],
    count: int,
    marker_error_mm: float,
    *,
    volume: Volume | None = None,
    axes: HeadAxes | None = None,
    seed: int = 0,
) -> ProposedMarkers:
    """Propose positions for `count` spheres that minimize the mean square error over the targets.

    On the skin shown by the CT, or on the ellipsoid without one; clear of the trajectories and of one
    another; on the cranium alone. The best of many random sets, improved by exchanging one marker
    at a time. Raises PLAN-021.
    """
    random = np.random.default_rng(seed)
    centres, posts = list_free_sites(head, trajectories, volume, random, axes)
    targets = np.array([one.target_mm for one in trajectories])
    sets = np.empty((0, count), np.int64)
    if len(centres):
        sets = random.integers(len(centres), size=(DRAWS, count))
        sets = sets[mark_allowed(centres[sets])]
    if not len(sets):
        raise NO_MARKER_SITES(
            f"there is no room for {count} markers clear of the trajectories and of one another",
            got=f"{len(centres)} positions on the skin between forehead and vertex",
        )
    by_target = tre_principal_axes_mm(targets, centres[sets], 1.0)
    chosen = _exchange_markers(centres, targets, sets[int(np.square(by_target).sum(axis=1).argmin())])
    expected = tre_principal_axes_mm(targets, centres[chosen], marker_error_mm)
    usual = np.percentile(by_target, USUAL, axis=0)
    return ProposedMarkers(
        markers=tuple(
            TemplateMarker(centre_mm=_round_vector(centres[site]), post=_round_vector(posts[site]))
            for site in chosen
        ),
        marker_error_mm=marker_error_mm,
        targets=tuple(
            ExpectedError(
                target=one.identifier, expected_mm=float(error_mm), usual_mm=marker_error_mm * float(middle)
            )
            for one, error_mm, middle in zip(trajectories, expected, usual, strict=True)
        ),
    )


def propose_further(
    head: HeadEllipsoid,
    trajectories: Sequence[Trajectory],
    present_mm: Array,
    marker_error_mm: float,
    *,
    volume: Volume | None = None,
    seed: int = 0,
) -> FurtherMarker:
    """Find the best position for one marker besides those at `present_mm` (n, 3). Raises PLAN-021."""
    centres, _ = list_free_sites(head, trajectories, volume, np.random.default_rng(seed))
    is_apart = np.linalg.norm(centres[:, None] - present_mm, axis=2).min(axis=1) >= APART_MM
    if not is_apart.any():
        raise NO_MARKER_SITES("there is no room for one more marker clear of the trajectories and the others")
    centres = centres[is_apart]
    targets = np.array([one.target_mm for one in trajectories])
    present = np.broadcast_to(present_mm, (len(centres), *present_mm.shape))
    sets = np.concatenate([present, centres[:, None]], axis=1)
    extended_errors_mm = tre_principal_axes_mm(targets, sets, marker_error_mm)
    best = int(np.square(extended_errors_mm).sum(axis=1).argmin())
    present_errors_mm = tre_principal_axes_mm(targets, present_mm, marker_error_mm)
    names = (one.identifier for one in trajectories)
    return FurtherMarker(
        centre_mm=_round_vector(centres[best]),
        targets=tuple(zip(names, present_errors_mm.tolist(), extended_errors_mm[best].tolist(), strict=True)),
    )


def propose_template(
    head: HeadEllipsoid, markers: int, margin_mm: float, *, volume: Volume | None = None, seed: int = 0
) -> MarkerTemplate:
    """Propose positions for 3 or 4 spheres whose mutual distances differ by at least `margin_mm`.

    On the skin shown by the CT, or on the ellipsoid without one. Raises PLAN-015 with the
    largest margin found.
    """
    random = np.random.default_rng(seed)
    centres, posts = list_sites(head, volume, random)
    if len(centres) < markers:
        raise NO_TEMPLATE("the CT shows no skin between forehead and vertex", got=f"{len(centres)} positions")
    sets = random.integers(len(centres), size=(TEMPLATE_DRAWS, markers))
    points = centres[sets]
    first, second = np.array(list(combinations(range(markers), 2))).T
    distances = np.sort(np.linalg.norm(points[:, first] - points[:, second], axis=2), axis=1)
    is_apart = distances[:, 0] >= APART_MM
    margins = np.where(is_apart, np.diff(distances, axis=1).min(axis=1), 0.0)
    if margins.max() < margin_mm:
        raise NO_TEMPLATE(
            f"no {markers} positions have distances that differ that much",
            expected=f"{margin_mm:g} mm",
            got=f"at most {margins.max():.1f} mm",
        )
    good = np.flatnonzero(margins >= margin_mm)
    expected = tre_principal_axes_mm(np.array([head.centre_mm]), points[good], 1.0)
    best = good[int(expected.argmin())]
    return MarkerTemplate(
        markers=tuple(
            TemplateMarker(centre_mm=_round_vector(centres[site], 6), post=_round_vector(posts[site], 6))
            for site in sets[best]
        )
    )


def list_free_sites(
    head: HeadEllipsoid,
    trajectories: Sequence[Trajectory],
    volume: Volume | None,
    random: np.random.Generator,
    axes: HeadAxes | None = None,
) -> tuple[Array, Array]:
    """Find skin positions clear of the trajectories, and the directions of their posts.

    Sphere and screw are on the cranium, and not on eyes, nose, ears, cheeks or jaw: by the `axes` of the
    head, or by those that the CT shows.
    """
    centres, posts = list_sites(head, volume, random)
    free = np.array([is_clear_of(trajectories, one) for one in centres], dtype=bool)
    if axes is None and volume is not None:
        axes = HeadAxes.of_points(sample_head(volume)[0])
    if axes is not None:
        for points_mm in (centres, centres - STANDOFF_MM * posts):
            free &= np.isin(axes.name_parts(points_mm), CRANIUM)
    return centres[free], posts[free]


def _exchange_markers(centres: Array, targets: Array, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
    """Relocate one marker at a time until the error no longer decreases."""

    def cost(points: Array) -> Array:
        return np.asarray(np.square(tre_principal_axes_mm(targets, points, 1.0)).sum(axis=-1))

    least = float(cost(centres[chosen][None])[0])
    for _ in range(MOST_ROUNDS):
        before = least
        for marker in range(len(chosen)):
            sets = np.tile(chosen, (len(centres), 1))
            sets[:, marker] = np.arange(len(centres))
            sets = sets[mark_allowed(centres[sets])]
            costs = cost(centres[sets])
            best = int(costs.argmin())
            if costs[best] < least:
                chosen, least = sets[best], float(costs[best])
        if least == before:
            break
    return chosen


def mark_allowed(points: Array) -> Mask:
    """Flag the sets (s, n, 3) with enough spacing and, for few markers, distinct distances."""
    first, second = np.array(list(combinations(range(points.shape[1]), 2))).T
    distances = np.sort(np.linalg.norm(points[:, first] - points[:, second], axis=2), axis=1)
    good = distances[:, 0] >= APART_MM
    if points.shape[1] < DISTINCT_BY_NUMBER:
        good &= np.diff(distances, axis=1).min(axis=1) >= DIFFER_MM
    return np.asarray(good)


def is_clear_of(trajectories: Sequence[Trajectory], centre_mm: Array) -> bool:
    """Return whether a position is clear of every trajectory's axis."""
    offsets = ((centre_mm - np.array(one.target_mm), one.axis_ct) for one in trajectories)
    return all(split_along(offset, axis)[0] >= CLEAR_OF_PATH_MM for offset, axis in offsets)


def list_sites(
    head: HeadEllipsoid, volume: Volume | None, random: np.random.Generator
) -> tuple[Array, Array]:
    """List possible sphere centres (s, 3) and the directions of their posts (s, 3)."""
    axes, middle = np.array(head.semi_axes_mm), np.array(head.centre_mm)
    directions = _cap_directions(random)
    skin = directions / np.linalg.norm(directions / axes, axis=1, keepdims=True)
    posts = skin / axes**2
    posts /= np.linalg.norm(posts, axis=1, keepdims=True)
    skin = skin + middle
    if volume is not None:
        depth = np.array([_skin_offset_mm(volume, one, post) for one, post in zip(skin, posts, strict=True)])
        shows_skin = np.isfinite(depth)
        skin, posts = skin[shows_skin] + depth[shows_skin, None] * posts[shows_skin], posts[shows_skin]
    return skin + STANDOFF_MM * posts, posts


def _cap_directions(random: np.random.Generator) -> Array:
    """Draw directions (s, 3), uniform over the cap."""
    cosine = random.uniform(np.cos(CAP_HALF_ANGLE_RAD), 1.0, SITES)
    turn, sine = random.uniform(0.0, 2.0 * np.pi, SITES), np.sqrt(1.0 - cosine**2)
    axis = np.array(CAP_AXIS) / np.linalg.norm(CAP_AXIS)
    side = np.array([1.0, 0.0, 0.0])
    across = np.outer(sine * np.cos(turn), side)
    return np.asarray(np.outer(cosine, axis) + across + np.outer(sine * np.sin(turn), np.cross(axis, side)))


def _skin_offset_mm(volume: Volume, start_mm: Array, outward: Array) -> float:
    """Return the outward distance from a point to the skin in mm, or NaN if it is missing or covered."""
    ring, _ = ring_around(outward)
    here = _first_solid_mm(volume, start_mm, outward)
    around = np.median([_first_solid_mm(volume, start_mm + RING_MM * one, outward) for one in ring])
    return here if abs(here - around) < FREE_SKIN_MM else float("nan")


def _first_solid_mm(volume: Volume, start_mm: Array, outward: Array) -> float:
    """Return the outward distance in mm from a point to the first object thicker than a sheet, or NaN."""
    steps_mm = np.arange(SKIN_MM[0], SKIN_MM[1], -SKIN_STEP_MM)
    hu = sample_hu(volume, start_mm + steps_mm[:, None] * outward)
    if len(hu) < len(steps_mm):
        return float("nan")  # beyond the CT
    solid = np.convolve(hu > AIR_BELOW_HU, np.ones(round(SKIN_THICK_MM / SKIN_STEP_MM)), "valid")
    first = np.flatnonzero(solid == round(SKIN_THICK_MM / SKIN_STEP_MM))
    return float(steps_mm[first[0]]) if len(first) else float("nan")


def write_template(path: Path, template: MarkerTemplate) -> None:
    """Write a template as TOML."""
    import tomli_w

    write_atomically(path, tomli_w.dumps(template.model_dump(mode="json", by_alias=True)).encode())


def _round_vector(vector: Array, decimals: int = 3) -> Numbers3:
    return vector3(round(float(value), decimals) for value in vector)
