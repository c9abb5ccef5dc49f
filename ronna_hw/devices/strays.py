"""Grouping of stray markers into spheres across frames, and averaging of each group.

While nothing moves, a reading belongs to the sphere whose mean is within `GROUP_RADIUS_MM`. While something
may move, `stray_tracks` compares it with the last position, within a wider gate.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ronna_hw.arguments import WrongArgument, require_numbers
from ronna_hw.arrays import Array
from ronna_hw.devices.errors import BAD_STRAYS
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.robust_scale import robust_sigma
from ronna_hw.vectors import Vector3

GROUP_RADIUS_MM = 4.0  # far above the tracker's noise, below the radius of a sphere: two never merge
# Spheres of 11.5 mm that touch are 11.5 mm apart: at rest, a reading has a single sphere within this. At 60
# frames in a second it follows a motion of 300 mm/s.
GATE_MM = 5.0
LEAST_SHARE = 0.5  # of the frames; a reflection or a flickering phantom is seen less often
OUTLIER_SIGMAS = 5.0  # from the median, in units of the median absolute deviation
LEAST_SIGMA_MM = 0.01  # a static reading has zero deviation, and must not be its own outlier


@dataclass(frozen=True)
class StrayGroup:
    """Readings of one stray sphere over several frames, in tracker coordinates.

    `mean_mm` (3,) excludes `outliers`; `spread_mm` is the rms distance of all readings from it, which reveals
    a moving sphere; `covariance_mm2` (3, 3) is that of one reading; `count` is the number of all readings.
    """

    mean_mm: Array
    spread_mm: float
    covariance_mm2: Array
    count: int
    outliers: int


@dataclass(frozen=True)
class StrayAverage:
    """Averaged strays: `groups` are spheres, `rejected` appeared in too few frames."""

    groups: tuple[StrayGroup, ...]
    rejected: tuple[StrayGroup, ...]
    frames: int


@dataclass
class _GroupBuilder:
    readings: list[Array] = field(default_factory=list)
    total: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def centre(self) -> Array:
        return self.total / len(self.readings)

    def add(self, reading: Array) -> None:
        self.readings.append(reading)
        self.total = self.total + reading


def average_strays(frames: Iterable[TrackerFrame]) -> StrayAverage:
    """Average the strays inside the measuring volume, excluding repeated measurements (STALE)."""
    return group_strays([positions for _, positions in select_strays(frames)])


def select_strays(frames: Iterable[TrackerFrame]) -> list[tuple[TrackerFrame, list[Vector3]]]:
    """Return each measured frame with its strays inside the measuring volume, mm. Repeats are left out.

    Raises ARG-001 for anything else than frames.
    """
    return [
        (frame, [one.position_mm for one in frame.strays if one.validity is Validity.OK])
        for frame in require_frames(frames)
        if frame.validity is not Validity.STALE
    ]


def require_frames(frames: Iterable[TrackerFrame]) -> Iterator[TrackerFrame]:
    """Yield the frames; raises ARG-001 at anything else."""
    for frame in frames if isinstance(frames, Iterable) else (frames,):
        if not isinstance(frame, TrackerFrame):
            raise WrongArgument(
                "strays are read from frames of the tracker",
                expected="TrackerFrame objects",
                got=type(frame).__name__,
                action="Give new_frames(tracker, 60); a loaded run has done it already: run.strays.identity.",
            )
        yield frame


def group_strays(
    frames: Sequence[Sequence[Vector3]],
    *,
    radius_mm: float = GROUP_RADIUS_MM,
    least_share: float = LEAST_SHARE,
) -> StrayAverage:
    """Group stray positions, mm, across frames.

    A group accepts one reading per frame, nearest first. Groups are in the order of their first appearance;
    those in fewer than `least_share` of the frames are rejected. Raises DEV-005.
    """
    if not (0.0 < radius_mm < math.inf and 0.0 <= least_share <= 1.0):
        raise BAD_STRAYS("the radius must be positive and the share between 0 and 1")
    groups: list[_GroupBuilder] = []
    for frame in frames:
        readings = require_positions(frame)
        for index in _assign(groups, readings, radius_mm):
            groups.append(_GroupBuilder())
            groups[-1].add(readings[index])
    least = max(1.0, least_share * len(frames))
    averages = [_average(group) for group in groups]
    return StrayAverage(
        groups=tuple(group for group in averages if group.count >= least),
        rejected=tuple(group for group in averages if group.count < least),
        frames=len(frames),
    )


def require_positions(frame: Sequence[Vector3]) -> Array:
    """Return the positions of one frame as an array (n, 3). Raises DEV-005."""
    readings = require_numbers(frame, "the positions of strays", mistake=BAD_STRAYS)
    if readings.size == 0:
        return np.zeros((0, 3))
    if readings.ndim != 2 or readings.shape[1] != 3 or not np.isfinite(readings).all():
        raise BAD_STRAYS("strays must be finite positions", expected="shape (n, 3)", got=f"{readings.shape}")
    return readings


def _assign(groups: list[_GroupBuilder], readings: Array, radius_mm: float) -> list[int]:
    """Add each reading to its group and return the unassigned readings."""
    centres = np.array([group.centre for group in groups]).reshape(-1, 3)
    pairs = pair_nearest(np.linalg.norm(readings[:, None] - centres[None], axis=-1), radius_mm)
    for reading, group in pairs.items():
        groups[group].add(readings[reading])
    return [reading for reading in range(len(readings)) if reading not in pairs]


def pair_nearest(distances_mm: Array, within_mm: float) -> dict[int, int]:
    """Pair readings (rows) with spheres (columns), each at most once, nearest pair first."""
    nearest = distances_mm.argmin(axis=1).tolist() if distances_mm.size else []
    if len(set(nearest)) == len(nearest):  # nothing to decide
        return {row: at for row, at in enumerate(nearest) if distances_mm[row, at] <= within_mm}
    left_mm = distances_mm.copy()
    pairs: dict[int, int] = {}
    while left_mm.size:
        row, column = (int(one) for one in np.unravel_index(int(left_mm.argmin()), left_mm.shape))
        if not left_mm[row, column] <= within_mm:
            break
        pairs[row] = column
        left_mm[row, :] = left_mm[:, column] = np.inf
    return pairs


def _average(group: _GroupBuilder) -> StrayGroup:
    readings = np.array(group.readings)
    from_median = np.linalg.norm(readings - np.median(readings, axis=0), axis=1)
    sigma = max(robust_sigma(from_median), LEAST_SIGMA_MM)
    kept = readings[from_median <= OUTLIER_SIGMAS * sigma]
    mean = kept.mean(axis=0)
    covariance = np.cov(kept.T) if len(kept) > 1 else np.zeros((3, 3))
    return StrayGroup(
        mean_mm=mean,
        spread_mm=float(np.sqrt(np.square(readings - mean).sum(axis=1).mean())),
        covariance_mm2=np.asarray(covariance, dtype=float),
        count=len(readings),
        outliers=len(readings) - len(kept),
    )
