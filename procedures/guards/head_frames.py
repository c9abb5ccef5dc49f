"""Displacement of the patient's spheres, frame by frame while the arm moves.

The tracker's noise is 0.2 mm in one frame, so the latest readings of each sphere are averaged. Hands and
drapes hide now one sphere, now another: none needs to be in every frame.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from procedures.guards.room_reading import LINE_MM
from procedures.registration.movement import LEAST_POINTS, NEAR_MM, measure_shift
from ronna_hw.arrays import Array
from ronna_hw.devices.readings import TrackerFrame, Validity

Flags = NDArray[np.bool_]
# Flags points (m, 3) that may be ghosts of known spheres (n, 3) and other markers, tracker frame.
GhostFinder = Callable[[Array, Array], Flags]

# Readings averaged. The depth of a sphere then has a noise of 0.07 mm, and the rms of three exceeds 0.3 mm
# once in 10^9; a shift of 0.5 mm exceeds it in the fifth or sixth reading.
AVERAGED = 8
# Rms of the spheres while the arm moves: between the noise of so many readings and the 0.5 mm that must be
# noticed on the way. At rest, the looks together are judged (`procedures.room`).
# Safety against a head that moves while the arm does. Source: simulated looks.
PATIENT_LIMIT_MM = 0.3

SPAN = 2 * AVERAGED  # frames back to which a sphere's readings count
# Mean displacement of all spheres in one reading from which the very next frame is read; a shift of 0.5 mm
# stays below it once in a thousand.
DOUBT_MM = 0.15
# Safety against a head that has left its place (U).
LEAST_FAR_MM = NEAR_MM / 2.0  # of spheres that are no longer near their places

FAR_READINGS = 3  # in a row that show spheres, but too few of them in place
# Spheres in place that show an unmoved head while the others are hidden; further points are glints and
# ghosts, of which one may form the distances of three spheres together with these two, or be beside the place
# of a third. With fewer, what may be a ghost counts as a sphere.
ENOUGH_IN_PLACE = 2


def no_ghosts(_spheres_mm: Array, points_mm: Array) -> Flags:
    """Flag no points, where no other markers are about."""
    return np.zeros(len(points_mm), dtype=bool)


@dataclass
class HeadFrames:
    """Recent readings of the head's spheres, expected at `spheres_mm` (n, 3) in the tracker's frame.

    `moved_mm` is their rms displacement, None while undecided. `doubtful` asks for the very next frame.
    `seen` says that the last frame showed enough spheres, and that it is not undecided for too long.
    """

    spheres_mm: Array
    moved_mm: float | None = None
    doubtful: bool = True
    seen: bool = True
    _far: int = 0
    _open: int = 0  # undecided frames in a row that showed enough spheres
    _displacements: deque[Array] = field(default_factory=lambda: deque(maxlen=SPAN))
    _uncertain: deque[Flags] = field(default_factory=lambda: deque(maxlen=SPAN))  # each may be of a ghost

    def add_frame(self, frame: TrackerFrame, ghosts: GhostFinder = no_ghosts) -> None:
        """Add a tracker frame, of which `ghosts` flags points that are no spheres."""
        self.add_places([one.position_mm for one in frame.strays if one.validity is Validity.OK], ghosts)

    def add_places(self, places: Sequence[Sequence[float]], ghosts: GhostFinder = no_ghosts) -> None:
        """Add the points that one frame shows, tracker frame."""
        displacements = _displacements(self.spheres_mm, places)
        near = np.isfinite(displacements[:, 0])
        uncertain = near.copy()  # beside a hidden sphere, a ghost would pass for it
        uncertain[near] = ghosts(self.spheres_mm, (self.spheres_mm + displacements)[near])
        displacements[uncertain & (np.sqrt((displacements**2).sum(axis=1)) > LINE_MM)] = np.nan
        near = np.isfinite(displacements[:, 0])
        self.seen = bool(near.sum() >= LEAST_POINTS)
        if self.seen:
            self._far = 0
            self._displacements.append(displacements)
            self._uncertain.append(uncertain)
            self.doubtful = math.hypot(*displacements[near].mean(axis=0)) > DOUBT_MM
            self.moved_mm = self._mean_mm()
            self._open = self._open + 1 if self.moved_mm is None else 0
            self.seen = self._open <= SPAN
        else:
            elsewhere = len(places) >= LEAST_POINTS and near.sum() < ENOUGH_IN_PLACE
            self._far = self._far + 1 if elsewhere else 0
            self.doubtful = 0 < self._far < FAR_READINGS
            moved = measure_shift(self.spheres_mm, places) if self._far == FAR_READINGS else None
            self.moved_mm = moved.rms_mm if moved is not None and moved.rms_mm >= LEAST_FAR_MM else None

    def _mean_mm(self) -> float | None:
        """Return the rms displacement of spheres with enough readings, or None if there are too few.

        A head moves as a whole, so the sphere that moved most is left out if three others remain: a hidden
        sphere of the x-shaped frame is reported 1 mm off, and a glint beside a hidden one passes for it. One
        that may be a ghost is left out if two others remain.
        """
        displacements = np.array(self._displacements)
        is_seen = np.isfinite(displacements[:, :, 0])
        latest = is_seen & (np.cumsum(is_seen[::-1], axis=0)[::-1] <= AVERAGED)
        enough = latest.sum(axis=0) == AVERAGED
        if enough.sum() < LEAST_POINTS:
            return None
        means = np.where(latest[:, :, None], displacements, 0.0).sum(axis=0)[enough] / AVERAGED
        certain = (latest & np.array(self._uncertain)).sum(axis=0)[enough] == 0
        if certain.sum() >= ENOUGH_IN_PLACE:
            means = means[certain]
        squares = np.sort((means * means).sum(axis=1))[: max(LEAST_POINTS, len(means) - 1)]
        return math.sqrt(float(squares.mean()))


@dataclass
class PatientFrames:
    """Recent readings of the spheres and of the patient's frame on the head clamp, if there is one.

    Each is judged by itself, so that neither hides what the other shows; either one seen is enough.
    """

    spheres: HeadFrames
    clamp: HeadFrames | None = None

    def add(
        self, frame: TrackerFrame, on_clamp_mm: Sequence[Sequence[float]], ghosts: GhostFinder = no_ghosts
    ) -> None:
        """Add a tracker frame, and the markers of the patient's frame by its pose in it."""
        if len(self.spheres.spheres_mm):
            self.spheres.add_frame(frame, ghosts)
        if self.clamp is not None:
            self.clamp.add_places(on_clamp_mm)

    @property
    def moved_mm(self) -> float | None:
        """Larger rms displacement of the two; None while undecided."""
        return max((one.moved_mm for one in self._both if one.moved_mm is not None), default=None)

    @property
    def doubtful(self) -> bool:
        """Whether the very next frame is wanted."""
        return any(one.doubtful for one in self._both)

    @property
    def seen(self) -> bool:
        """Whether the last frame showed enough of either."""
        return any(one.seen for one in self._both)

    @property
    def _both(self) -> tuple[HeadFrames, ...]:
        enough = len(self.spheres.spheres_mm) >= LEAST_POINTS or self.clamp is None
        spheres = (self.spheres,) if enough else ()
        return spheres if self.clamp is None else (*spheres, self.clamp)


def _displacements(spheres_mm: Array, places_mm: Sequence[Sequence[float]]) -> Array:
    """Return each sphere's displacement (n, 3) to the nearest measured point, NaN if none is near."""
    displacements = np.full(spheres_mm.shape, np.nan)
    if places_mm:
        apart = np.asarray(places_mm)[None] - spheres_mm[:, None]
        squared = (apart * apart).sum(axis=2)
        nearest = squared.argmin(axis=1)
        rows = np.arange(len(spheres_mm))
        near = squared[rows, nearest] < NEAR_MM**2
        displacements[near] = apart[rows, nearest][near]
    return displacements
