"""Strays carry no identity: find the same sphere again in frame after frame, and average it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.registration.errors import BadParameter
from procedures.registration.points import checked_points

Array = NDArray[np.float64]

GROUP_RADIUS_MM = 4.0  # far above the tracker's noise, below the radius of a sphere: two never merge
LEAST_SHARE = 0.5  # of the frames; a reflection that flickers is seen less often
OUTLIER_SIGMAS = 5.0  # from the median, by the scale of the median absolute deviation
MAD_TO_SIGMA = 1.4826  # for normal noise
LEAST_SIGMA_MM = 0.01  # a still reading has a deviation of zero, and must not be its own outlier


@dataclass(frozen=True)
class StrayGroup:
    """One sphere over the frames.

    `mean_mm` (3,) over the readings without `outliers`, `spread_mm` the rms distance of all readings from
    it, so that a sphere that moved shows, `covariance_mm2` (3, 3) of one reading, `count` readings in all.
    """

    mean_mm: Array
    spread_mm: float
    covariance_mm2: Array
    count: int
    outliers: int


@dataclass
class _Growing:
    readings: list[Array] = field(default_factory=list)
    total: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def centre(self) -> Array:
        return self.total / len(self.readings)

    def add(self, reading: Array) -> None:
        self.readings.append(reading)
        self.total = self.total + reading


def group_strays(
    frames: Sequence[ArrayLike],
    *,
    radius_mm: float = GROUP_RADIUS_MM,
    least_share: float = LEAST_SHARE,
) -> tuple[StrayGroup, ...]:
    """Group the strays (k, 3) in mm of each frame; spheres seen in too few frames are left out.

    Within a frame a group takes one reading, the nearest first. Ordered by first appearance. Raises REG-001
    for malformed readings, REG-007 for an impossible radius or share.
    """
    if not (0.0 < radius_mm < np.inf and 0.0 <= least_share <= 1.0):
        raise BadParameter("a radius must be positive, a share between 0 and 1")
    groups: list[_Growing] = []
    for frame in frames:
        readings = checked_points(frame, "stray")
        free = _assign(groups, readings, radius_mm)
        for index in free:
            groups.append(_Growing())
            groups[-1].add(readings[index])
    least = max(1.0, least_share * len(frames))
    return tuple(_average(group) for group in groups if len(group.readings) >= least)


def _assign(groups: list[_Growing], readings: Array, radius_mm: float) -> list[int]:
    """Give each reading to the nearest group that has none in this frame; returns the readings left over."""
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


def _average(group: _Growing) -> StrayGroup:
    readings = np.array(group.readings)
    from_median = np.linalg.norm(readings - np.median(readings, axis=0), axis=1)
    sigma = max(MAD_TO_SIGMA * float(np.median(from_median)), LEAST_SIGMA_MM)
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
