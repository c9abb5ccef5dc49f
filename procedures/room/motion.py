"""Motion of head, cart or tracker, if a further look does not fit the looks before it.

First each body that the look shows is held against where it is expected. Where each seems in place, the looks
together may still show a motion, by less than one of them tells: small, slow, or in a direction that one pose
of the arm hardly shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.special import chdtri

from procedures.room.estimate import (
    AXES,
    FALSE_ALARM,
    GUIDE_AT_HEAD,
    INSTRUMENT_IN_GUIDE,
    MOVING,
    RoomEstimate,
)
from procedures.room.model import BASES, Body, Rows
from procedures.room.sighting import Tracked
from ronna_hw.arrays import Array

# A hypothesis stands unless it is wrong with more than this confidence. The better one is named if it is this
# much more likely, in chi-square; else both are.
# Safety against a moved body that is taken for another (U).
DOUBTED = 1e-3
BETTER = 14.0

TURNED_SHARE = 1.1  # of its own displacement, beyond which a body's motion is told at the point that counts


class Moved(StrEnum):
    """Body that has moved, as far as the looks tell it."""

    BASE = "base"
    ASSISTANT = "assistant"
    HEAD = "head"
    HEAD_IN_CLAMP = "head in its clamp"
    CLAMP_FRAME = "frame on the clamp"
    TRACKER = "tracker"
    HEAD_OR_TRACKER = "head or tracker"
    SEVERAL = "two of head, cart and tracker"


# Motions that displace what is far from the body by more than the body itself, and in which direction.
TURNING = {
    Moved.BASE: {"base": 1.0},
    Moved.ASSISTANT: {"assistant": 1.0},
    Moved.HEAD: {"head": 1.0},
    Moved.HEAD_OR_TRACKER: {"head": 1.0},
}
WAYS = {**TURNING, Moved.TRACKER: {"tracker": -1.0}}  # as the tracker sees what it has moved against
# What displaces that which an arm carries from where it belongs: guide at the head, instrument in the guide.
CARRIED = {Tracked.ARM: GUIDE_AT_HEAD, Tracked.ASSISTANT: INSTRUMENT_IN_GUIDE}


@dataclass(frozen=True)
class RoomMotion:
    """Motion that the looks show; `chi_square` exceeds `limit`.

    `since` is the look before which it happened, `way_mm` (3,) its estimate in the robot frame: at the point
    named `at`, where it counts, or if that is None of the body itself.
    """

    moved: Moved
    since: int
    chi_square: float
    limit: float
    way_mm: Array
    at: str | None = None

    @property
    def moved_mm(self) -> float:
        return float(np.linalg.norm(self.way_mm))

    @property
    def noticed_share(self) -> float:
        """Share of this motion that would just be noticed."""
        return float(np.sqrt(self.limit / self.chi_square))

    @property
    def limit_mm(self) -> float:
        """Length in the same direction that would just be noticed."""
        return self.noticed_share * self.moved_mm


def find_motion(
    known: RoomEstimate,
    rows: Rows,
    points_mm: Mapping[str, Array],
    unpushed: Callable[[], Rows | None] = lambda: None,
) -> RoomMotion | None:
    """Return the motion that one look more shows, or None.

    `points_mm` are the points (3,) that count, robot frame, by name. `unpushed` gives the look as the tracker
    would have it had it moved as the head seems to; None if the head does not show how.
    """
    found = _find_by_body(known, rows, unpushed)
    if found is None:
        return find_hidden_motion(known.add(rows), points_mm)
    return _seen_at_points(found, known.add(rows), points_mm)


def _seen_at_points(found: RoomMotion, estimate: RoomEstimate, points_mm: Mapping[str, Array]) -> RoomMotion:
    """Return the motion as it counts: a body that has turned displaces what is far from it by more."""
    if found.moved not in TURNING:
        return found
    for name, point_mm in points_mm.items():
        way_mm = estimate.displacement(point_mm, found.since, TURNING[found.moved]).way_mm
        if np.linalg.norm(way_mm) > TURNED_SHARE * found.moved_mm:
            found = replace(found, way_mm=way_mm, at=name)
    return found


def _find_by_body(known: RoomEstimate, rows: Rows, unpushed: Callable[[], Rows | None]) -> RoomMotion | None:
    values, covariance = known.innovation(rows)
    chi_squares, limits = {}, {}
    for body, block in rows.blocks.items():
        chi_squares[body] = _chi_square(values[block], covariance[block, block])
        limits[body] = _limit(len(values[block]), FALSE_ALARM)
    out = {body for body, chi_square in chi_squares.items() if chi_square > limits[body]}
    if not out:
        return None

    def motion(moved: Moved) -> RoomMotion:
        worst = max(out, key=lambda body: chi_squares[body] / limits[body])
        shown = Body.BASE if moved in (Moved.BASE, Moved.SEVERAL) else worst
        way_mm = _way_mm(values[rows.blocks[shown]], shown)
        return RoomMotion(moved, len(known.looks), chi_squares[shown], limits[shown], way_mm)

    arms = set(BASES.values())
    if len(out) == 1 and out <= arms:
        return motion(Moved.BASE if Body.BASE in out else Moved.ASSISTANT)
    pushed = unpushed()
    if pushed is not None and _fits_pushed(known, pushed):
        return motion(Moved.TRACKER if out & arms else Moved.HEAD_OR_TRACKER)
    if out <= arms:
        return motion(Moved.BASE)
    if Body.BASE in out:
        return motion(Moved.SEVERAL)
    out -= arms  # the arm with the guide is in its place: the head counts
    if {Body.SPHERES, Body.CLAMP} <= rows.blocks.keys() and len(out) == 1:
        return motion(Moved.CLAMP_FRAME if Body.CLAMP in out else Moved.HEAD_IN_CLAMP)
    return motion(Moved.HEAD)


def _way_mm(values: Array, body: Body) -> Array:
    """Return the mean displacement (3,) of a body from the rows of its residual."""
    return values[:3] if body is not Body.SPHERES else values.reshape(-1, 3).mean(axis=0)


def _fits_pushed(known: RoomEstimate, rows: Rows) -> bool:
    """Whether a small motion of the tracker explains a look, or the look shows too little to exclude it."""
    values, covariance = known.innovation(rows)
    moving = rows.moved @ MOVING["tracker"]
    weighted = np.linalg.solve(covariance, moving)
    motion = np.linalg.lstsq(moving.T @ weighted, weighted.T @ values)[0]
    freedom = len(values) - moving.shape[1]
    return freedom <= 0 or _chi_square(values - moving @ motion, covariance) < _limit(freedom, DOUBTED)


def find_hidden_motion(
    estimate: RoomEstimate, points_mm: Mapping[str, Array], first: int = 1
) -> RoomMotion | None:
    """Return a motion before look `first` or later that all looks show together, or None."""
    moments = len(estimate.looks) - first
    if moments < 1:
        return None
    # It is the largest of so many that is judged: each has its share of the rate (Bonferroni).
    share = FALSE_ALARM / moments
    found: list[RoomMotion] = []
    chi_squares, weights = estimate.explained(first=first)
    limits = _limits(weights, share)
    if (chi_squares > limits).any():
        at = int((chi_squares / limits).argmax())
        since = first + at
        moved = _name(estimate, since)
        way_mm = estimate.displacement(estimate.model.centre_mm, since, WAYS[moved]).way_mm
        motion = RoomMotion(moved, since, float(chi_squares[at]), float(limits[at]), way_mm)
        found.append(_seen_at_points(motion, estimate, points_mm))
    for name, point_mm in points_mm.items():
        limit = _limit(AXES, share)
        for arm in estimate.model.arms:
            largest = estimate.largest(point_mm, first, CARRIED[arm])
            if largest is not None and largest.chi_square > limit:
                moved, since = _name(estimate, largest.since), largest.since
                found.append(RoomMotion(moved, since, largest.chi_square, limit, largest.way_mm, name))
    return max(found, key=lambda one: one.chi_square / one.limit, default=None)


def _name(estimate: RoomEstimate, since: int) -> Moved:
    """Name the body whose motion explains most; of two that explain as much, the more cautious."""
    by_body = {
        Moved(name): float(estimate.explained(name, since)[0][0])
        for name in (Moved.HEAD, Moved.BASE, Moved.TRACKER, Moved.ASSISTANT)
    }
    most = max(by_body.values())
    fits = {body for body, explained in by_body.items() if most - explained <= BETTER}
    if fits == {Moved.TRACKER}:
        return Moved.TRACKER
    if fits <= {Moved.HEAD, Moved.TRACKER}:
        return Moved.HEAD_OR_TRACKER if Moved.TRACKER in fits else Moved.HEAD
    return max(fits - {Moved.TRACKER}, key=by_body.__getitem__)


def _chi_square(values: Array, covariance: Array) -> float:
    return float(values @ np.linalg.solve(covariance, values))


def _limits(weights: Array, share: float) -> Array:
    """Return limits (k,) on sums of squares of unit normals with these weights (k, m).

    By two moments: Satterthwaite 1946, An approximate distribution of estimates of variance components.
    """
    mean, square = weights.sum(axis=1), (weights**2).sum(axis=1)
    return np.asarray(square / mean * chdtri(mean**2 / square, share))


def _limit(freedom: int, confidence: float) -> float:
    return float(chdtri(freedom, confidence))
