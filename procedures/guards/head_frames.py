"""The patient's spheres frame by frame while the arm moves: are they where they were localized?

The tracker's noise is 0.2 mm in one frame, so the last readings of each sphere are averaged. Hands and drapes
hide one sphere here and another there: none has to be in all of them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from procedures.registration.movement import LEAST_POINTS, NEAR_MM, shift_of
from ronna_hw.devices.readings import TrackerFrame, Validity

Array = NDArray[np.float64]

# Readings that are averaged. The depth of a sphere then has a noise of 0.07 mm, and the rms of three passes
# 0.3 mm once in 10^9; a shift of 0.5 mm passes it with the fifth or sixth reading that has it.
AVERAGED = 8
SPAN = 2 * AVERAGED  # frames back to which a sphere's readings count
# Mean way of all spheres in one reading that is worth the very next frame: 0.5 mm make less than this once in
# a thousand.
DOUBT_MM = 0.15
LEAST_FAR_MM = NEAR_MM / 2.0  # of spheres that are no longer near their places
FAR_READINGS = 3  # in a row that show spheres, but too few where they were
# With the other spheres hidden: the head lies where it was, and what else is seen are glints and phantoms.
# One of them and these two may have the distances of three spheres.
ENOUGH_IN_PLACE = 2


@dataclass
class HeadFrames:
    """The last readings. `spheres_mm` (n, 3) are those on the head, tracker frame.

    `moved_mm` is the rms by which they have moved, None while that is open; `doubtful` says that the next
    frame should be read, `seen` that the last one showed enough of them, and that those before did not leave
    it open for long whether they have moved.
    """

    spheres_mm: Array
    moved_mm: float | None = None
    doubtful: bool = True
    seen: bool = True
    _far: int = 0
    _open: int = 0  # frames in a row that showed enough of them and said nothing
    _ways: deque[Array] = field(default_factory=lambda: deque(maxlen=SPAN))

    def take(self, frame: TrackerFrame) -> None:
        """Add a reading."""
        places = [one.position_mm for one in frame.strays if one.validity is Validity.OK]
        ways = _ways(self.spheres_mm, places)
        near = np.isfinite(ways[:, 0])
        self.seen = bool(near.sum() >= LEAST_POINTS)
        if self.seen:
            self._far = 0
            self._ways.append(ways)
            self.doubtful = math.hypot(*ways[near].mean(axis=0)) > DOUBT_MM
            self.moved_mm = self._mean_mm()
            self._open = self._open + 1 if self.moved_mm is None else 0
            self.seen = self._open <= SPAN
        else:
            elsewhere = len(places) >= LEAST_POINTS and near.sum() < ENOUGH_IN_PLACE
            self._far = self._far + 1 if elsewhere else 0
            self.doubtful = 0 < self._far < FAR_READINGS
            moved = shift_of(self.spheres_mm, places) if self._far == FAR_READINGS else None
            self.moved_mm = moved.rms_mm if moved is not None and moved.rms_mm >= LEAST_FAR_MM else None

    def _mean_mm(self) -> float | None:
        """The rms over the spheres with enough readings; None while they are too few.

        Without the one that has moved most, if three others remain: a head moves as a whole. A hidden sphere
        of the x-shaped frame is where the others have it, 1 mm off; a glint next to a hidden one passes for
        it.
        """
        ways = np.array(self._ways)
        there = np.isfinite(ways[:, :, 0])
        latest = there & (np.cumsum(there[::-1], axis=0)[::-1] <= AVERAGED)
        enough = latest.sum(axis=0) == AVERAGED
        if enough.sum() < LEAST_POINTS:
            return None
        means = np.where(latest[:, :, None], ways, 0.0).sum(axis=0)[enough] / AVERAGED
        squares = np.sort((means * means).sum(axis=1))[: max(LEAST_POINTS, len(means) - 1)]
        return math.sqrt(float(squares.mean()))


def _ways(spheres_mm: Array, places_mm: Sequence[Sequence[float]]) -> Array:
    """From each sphere's place to the nearest that is seen there (n, 3); NaN where none is near."""
    ways = np.full(spheres_mm.shape, np.nan)
    if places_mm:
        apart = np.asarray(places_mm)[None] - spheres_mm[:, None]
        squared = (apart * apart).sum(axis=2)
        nearest = squared.argmin(axis=1)
        rows = np.arange(len(spheres_mm))
        near = squared[rows, nearest] < NEAR_MM**2
        ways[near] = apart[rows, nearest][near]
    return ways
