"""Grouping of stray markers into spheres across frames, and averaging of each group."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ronna_hw.devices.errors import BadStrays
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.robust_scale import robust_sigma
from ronna_hw.vectors import Vector3

Array = NDArray[np.float64]

GROUP_RADIUS_MM = 4.0  # far above the tracker's noise, below the radius of a sphere: two never merge
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
    measurements = [frame for frame in frames if frame.validity is not Validity.STALE]
    return group_strays(
        [
            [stray.position_mm for stray in frame.strays if stray.validity is Validity.OK]
            for frame in measurements
        ]
    )


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
        raise BadStrays("the radius must be positive and the share between 0 and 1")
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
    readings = np.asarray(frame, dtype=float)
    if readings.size == 0:
        return np.zeros((0, 3))
    if readings.ndim != 2 or readings.shape[1] != 3 or not np.isfinite(readings).all():
        raise BadStrays("strays must be finite positions", expected="shape (n, 3)", got=f"{readings.shape}")
    return readings


def _assign(groups: list[_GroupBuilder], readings: Array, radius_mm: float) -> list[int]:
    """Assign each reading to the nearest free group and return the unassigned readings."""
    free = list(range(len(readings)))
    if not groups or not free:
        return free
    centres = np.array([group.centre for group in groups])
    distances = np.linalg.norm(readings[:, None] - centres[None], axis=-1)
    while free:
        reading, group = np.unravel_index(int(distances.argmin()), distances.shape)
        if not distances[reading, group] <= radius_mm:
            break
        groups[group].add(readings[reading])
        free.remove(int(reading))
        distances[reading, :] = np.inf
        distances[:, group] = np.inf
    return free


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
