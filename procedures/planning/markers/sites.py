"""Marker positions on a head that minimize the error at the planned targets.

Markers serve a target best when their centroid is near it and they are far from the principal axes through
it: eq. 39. For comparison, what a person would choose freehand is drawn at random, spread over the same skin.
The arm's own errors are not included: they depend on the pose of the head.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.planning.errors import NoMarkerSites
from procedures.planning.head.shape import HeadEllipsoid
from procedures.planning.markers.template import APART_MM, sites_on
from procedures.registration.error_theory import tre_principal_axes_mm
from procedures.strategies.trajectory import Trajectory
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.marker_template import TemplateMarker

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

FEWEST, MOST = 3, 8
CLEAR_OF_WAY_MM = 30.0  # of a marker's centre from a trajectory: the guide's radius, a sphere, a margin
DIFFER_MM = 6.0  # between the distances of three or four markers, which might otherwise be confused
DISTINCT_BY_NUMBER = 5
DRAWS = 20_000  # random sets tried first, representing freehand choices
USUAL = 50.0  # per cent of them are better
MOST_ROUNDS = 20  # of exchanges; three to five is usual


class ExpectedError(Strict):
    """For one target."""

    target: str = Field(description="Trajectory of the plan.")
    expected_mm: float = Field(description="Rms error with the proposed markers.")
    usual_mm: float = Field(description="Median with markers placed at random over the same skin.")


class ProposedMarkers(Strict):
    """Marker positions, and their expected effect on each target."""

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
    """Where one more marker helps most, and for each target the rms error now and with it, mm."""

    centre_mm: Numbers3
    targets: tuple[tuple[str, float, float], ...]


def propose_markers(
    head: HeadEllipsoid,
    trajectories: Sequence[Trajectory],
    count: int,
    marker_error_mm: float,
    *,
    volume: Volume | None = None,
    seed: int = 0,
) -> ProposedMarkers:
    """Positions for `count` spheres with the least mean square error over the targets.

    On the skin shown by the CT, or on the ellipsoid without one; clear of the trajectories and of one
    another. The best of many random sets, improved by exchanging one marker at a time. Raises PLAN-021.
    """
    random = np.random.default_rng(seed)
    centres, posts = _free_sites(head, trajectories, volume, random)
    targets = np.array([one.target_mm for one in trajectories])
    sets = (
        random.integers(len(centres), size=(DRAWS, count)) if len(centres) else np.empty((0, count), np.int64)
    )
    sets = sets[allowed(centres[sets])] if len(sets) else sets
    if not len(sets):
        raise NoMarkerSites(
            f"there is no room for {count} markers clear of the trajectories and of one another",
            got=f"{len(centres)} positions on the skin between forehead and vertex",
        )
    by_target = tre_principal_axes_mm(targets, centres[sets], 1.0)
    chosen = _exchanged(centres, targets, sets[int(np.square(by_target).sum(axis=1).argmin())])
    expected = tre_principal_axes_mm(targets, centres[chosen], marker_error_mm)
    usual = np.percentile(by_target, USUAL, axis=0)
    return ProposedMarkers(
        markers=tuple(
            TemplateMarker(centre_mm=_three(centres[site]), post=_three(posts[site])) for site in chosen
        ),
        marker_error_mm=marker_error_mm,
        targets=tuple(
            ExpectedError(
                target=one.identifier,
                expected_mm=float(error_mm),
                usual_mm=marker_error_mm * float(middle),
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
    """Where one more marker besides those (n, 3) helps the targets most. Raises PLAN-021."""
    centres, _ = _free_sites(head, trajectories, volume, np.random.default_rng(seed))
    apart = np.linalg.norm(centres[:, None] - present_mm, axis=2).min(axis=1) >= APART_MM
    if not apart.any():
        raise NoMarkerSites("there is no room for one more marker clear of the trajectories and the others")
    centres = centres[apart]
    targets = np.array([one.target_mm for one in trajectories])
    sets = np.concatenate(
        [np.broadcast_to(present_mm, (len(centres), *present_mm.shape)), centres[:, None]], axis=1
    )
    with_it = tre_principal_axes_mm(targets, sets, marker_error_mm)
    best = int(np.square(with_it).sum(axis=1).argmin())
    now = tre_principal_axes_mm(targets, present_mm, marker_error_mm)
    names = (one.identifier for one in trajectories)
    return FurtherMarker(
        centre_mm=_three(centres[best]),
        targets=tuple(zip(names, now.tolist(), with_it[best].tolist(), strict=True)),
    )


def _free_sites(
    head: HeadEllipsoid,
    trajectories: Sequence[Trajectory],
    volume: Volume | None,
    random: np.random.Generator,
) -> tuple[Array, Array]:
    """Positions on the skin clear of the trajectories, and directions of their posts."""
    centres, posts = sites_on(head, volume, random)
    free = np.array([clear_of(trajectories, one) for one in centres], dtype=bool)
    return centres[free], posts[free]


def _exchanged(centres: Array, targets: Array, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
    """The set after moving markers to other positions as long as that lowers the error."""

    def cost(points: Array) -> Array:
        return np.asarray(np.square(tre_principal_axes_mm(targets, points, 1.0)).sum(axis=-1))

    least = float(cost(centres[chosen][None])[0])
    for _ in range(MOST_ROUNDS):
        before = least
        for marker in range(len(chosen)):
            sets = np.tile(chosen, (len(centres), 1))
            sets[:, marker] = np.arange(len(centres))
            sets = sets[allowed(centres[sets])]
            costs = cost(centres[sets])
            best = int(costs.argmin())
            if costs[best] < least:
                chosen, least = sets[best], float(costs[best])
        if least == before:
            break
    return chosen


def allowed(points: Array) -> NDArray[np.bool_]:
    """Which sets (s, n, 3) are spaced apart and, if so few that they could be confused, differ enough."""
    first, second = np.array(list(combinations(range(points.shape[1]), 2))).T
    distances = np.sort(np.linalg.norm(points[:, first] - points[:, second], axis=2), axis=1)
    good = distances[:, 0] >= APART_MM
    if points.shape[1] < DISTINCT_BY_NUMBER:
        good &= np.diff(distances, axis=1).min(axis=1) >= DIFFER_MM
    return np.asarray(good)


def clear_of(trajectories: Sequence[Trajectory], centre_mm: Array) -> bool:
    """Whether a position is clear of every trajectory's line."""
    for one in trajectories:
        away = centre_mm - np.array(one.target_mm)
        if np.linalg.norm(away - (away @ one.axis_ct) * one.axis_ct) < CLEAR_OF_WAY_MM:
            return False
    return True


def _three(vector: Array) -> Numbers3:
    x, y, z = (round(float(value), 3) for value in vector)
    return x, y, z
