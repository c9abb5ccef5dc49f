"""Tracks that are where lines of sight to two others cross: phantoms of a tracker with two sensors.

Each sensor sees directions only. Two markers whose lines of sight pass close to each other are seen at up to
four places: their own, and two at which the line of one sensor to the first crosses that of the other sensor
to the second. Such a point is midway between the two lines, which tells it from a marker as long as the lines
pass each other farther apart than the tracker's own error. Closer, the four places explain each other: two
are phantoms, and which ones their places do not say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ronna_hw.arrays import Array

# The two sensors, tracker frame, mm: half a metre apart about the origin, along y. A sphere is measured only
# if both see it. An estimate: manufacturers publish the outer size of their units, 0.6 m.
SENSORS_MM = ((0.0, -250.0, 0.0), (0.0, 250.0, 0.0))
MOST_APART_MM = 5.0  # of two lines: trackers take no lines that are farther apart for one marker
# From the middle of the two lines; the tracker's bias differs between places by some tenths. Along the depth
# an error across it counts several times, and with the square of the depth.
ACROSS_MM, ALONG_MM, AT_DEPTH_MM = 1.0, 4.0, 2000.0
TRACK = "track "  # followed by its identity
LEAST_ANGLE = 1e-9  # sine squared, between two lines that may cross


@dataclass(frozen=True)
class CrossedSight:
    """Track at which the left sensor's line to one track crosses the right sensor's line to another."""

    track: int  # index of each
    left: int
    right: int


def find_crossed_sights(places_mm: Array) -> tuple[CrossedSight, ...]:
    """Find the tracks, by their mean places (n, 3) in the tracker frame, that are such crossings."""
    count = len(places_mm)
    left, right = np.repeat(np.arange(count), count), np.tile(np.arange(count), count)
    left, right = left[left != right], right[left != right]
    eyes = np.asarray(SENSORS_MM)
    a, b = places_mm[left] - eyes[0], places_mm[right] - eyes[1]
    base = eyes[0] - eyes[1]
    aa, bb, ab = ((u * v).sum(axis=1) for u, v in ((a, a), (b, b), (a, b)))
    determinant = aa * bb - ab * ab
    crosses = determinant > LEAST_ANGLE * aa * bb
    left, right, a, b = left[crosses], right[crosses], a[crosses], b[crosses]
    aa, bb, ab, determinant = aa[crosses], bb[crosses], ab[crosses], determinant[crosses]
    along_a, along_b = (ab * (b @ base) - bb * (a @ base)), (aa * (b @ base) - ab * (a @ base))
    on_a = eyes[0] + (along_a / determinant)[:, None] * a
    on_b = eyes[1] + (along_b / determinant)[:, None] * b
    close = np.linalg.norm(on_a - on_b, axis=1) <= MOST_APART_MM
    left, right, middle = left[close], right[close], ((on_a + on_b) / 2.0)[close]
    off = np.abs(places_mm[:, None] - middle)  # (tracks, pairs, 3)
    depth = ALONG_MM * np.square(middle[:, 2] / AT_DEPTH_MM)
    is_there = (np.hypot(off[..., 0], off[..., 1]) <= ACROSS_MM) & (off[..., 2] <= depth)
    found = [CrossedSight(int(one), int(left[pair]), int(right[pair])) for one, pair in np.argwhere(is_there)]
    return tuple(one for one in found if one.track not in (one.left, one.right))


def describe_crossed_sights(found: Sequence[CrossedSight], names: Sequence[str]) -> tuple[str, ...]:
    """Name each track that is a phantom by its place, and together those of which some are.

    `names` are those of the tracks, and of known markers after them, which are no phantoms. A track counts as
    a phantom if it is explained by two places that nothing explains.
    """
    suspects = {one.track for one in found}
    sentences = []
    certain = set()
    for one in found:
        if one.track not in certain and not suspects & {one.left, one.right}:
            certain.add(one.track)
            sentences.append(
                f"{names[one.track]} is where lines of sight to "
                f"{_name_both(names[one.left], names[one.right])} cross: a phantom"
            )
    if undecided := sorted(suspects - certain):
        listed = ", ".join(names[one].removeprefix(TRACK) for one in undecided)
        sentences.append(
            f"tracks {listed} are each where lines of sight to two others cross: at most half of them are "
            "spheres, and their places do not say which"
        )
    return tuple(sentences)


def _name_both(one: str, other: str) -> str:
    if one.startswith(TRACK) and other.startswith(TRACK):
        return f"tracks {one.removeprefix(TRACK)} and {other.removeprefix(TRACK)}"
    return f"{one} and {other}"
