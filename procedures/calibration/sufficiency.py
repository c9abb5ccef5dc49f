"""Whether the data suffice for a calibration: enough views, varied enough, consistent with each other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.errors import DegeneratePoses, DoesNotFit, TooFewPoses
from ronna_hw.text import beyond

LEAST_SPREAD_DEG = 8.0  # rms over the poses, for the direction that varies least


def require_count(count: int, least: int, what: str, action: str | None = None) -> None:
    """Raises CAL-002, with `what` there is too little of, below the minimum count."""
    if count < least:
        raise TooFewPoses(what, expected=f"at least {least}", got=str(count), action=action)


def require_spread(rotations: NDArray[np.float64], what: str, action: str | None = None) -> None:
    """Raises CAL-003, with `what` varies too little, if one direction of rotations (n, 3, 3) hardly does."""
    if (spread := orientation_spread(rotations)) < math.sin(math.radians(LEAST_SPREAD_DEG)):
        raise DegeneratePoses(
            what,
            limit=f"{LEAST_SPREAD_DEG:g} deg rms about every axis",
            got=f"{beyond(math.degrees(math.asin(spread)), LEAST_SPREAD_DEG, 1)} deg",
            action=action,
        )


def require_consistent(used: NDArray[np.bool_], most_outliers: float, what: str) -> None:
    """Raises CAL-004 if more than this fraction of `what` are outliers; `used` marks the inliers."""
    if (outliers := float(np.mean(~used))) > most_outliers:
        raise DoesNotFit(
            f"too many {what} disagree with the others",
            limit=f"{most_outliers:.0%}",
            got=f"{beyond(100 * outliers, 100 * most_outliers, 0)}%",
        )


def orientation_spread(rotations: NDArray[np.float64]) -> float:
    """Rms variation of rotations (n, 3, 3) in the direction that varies least; 0 about a single axis."""
    apart = rotations - rotations.mean(axis=0)
    scatter = np.einsum("nki,nkj->ij", apart, apart) / len(rotations)
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(scatter)[0])))
