"""The guide's tip in the tool frame of the stereo head on the same mount.

In one orientation, and within millimetres of one position, an arm's errors are the same with the head over
the ball and with the tip in the divot that replaces the ball. The difference of the two is the tip relative
to the head's measurement, and hardly depends on the arm:

    tip = T'^-1 (T ball + dials)    T, T': ROBOT <- TOOL over the ball and in the divot

Pivoting about the divot provides a second answer, which does not assume ball and divot at the same position:
what turns with the tool is the tip, what stays is the gap between divot and ball. The gap must be small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.errors import BallAndDivotApart, DoesNotFit
from procedures.calibration.sufficiency import require_count, require_spread
from procedures.calibration.tool_tip.looks import TipPairs
from ronna_hw.text import beyond

Array = NDArray[np.float64]

LEAST_READINGS = 8  # with fewer, pivoting leaves more than MOST_OPEN_MM undetermined with some good stands
SAME_ORIENTATION_RAD = float(np.radians(0.5))  # beyond this, the arm's errors do not cancel
LARGEST_SCATTER_MM = 0.08  # per axis: good arms and stands show 0.02 to 0.03
LEAST_SCATTER_MM = 0.003  # nothing repeats better
LARGEST_GAP_MM = 0.08  # between ball and divot; a smaller gap adds to the tip's error: the stand must be good
MOST_OPEN_MM = 0.2  # no larger gap goes unnoticed; good readings at the step's poses leave 0.07 to 0.17
SURE = 3.0  # standard errors, if pivoting leaves more than that undetermined
LARGEST_PIVOT_SCATTER_MM = 0.05  # per axis: good ones show up to 0.035; a larger one would excuse any gap


@dataclass(frozen=True)
class TipFit:
    """`tip_mm` (3,) in the head's tool frame, with covariance (3, 3) mm2; `scatter_mm` per axis.

    `gap_mm` (3,) is the divot's offset from the ball according to pivoting, robot axes, with a standard error
    of `gap_error_mm` in space.
    """

    tip_mm: Array
    covariance_mm2: Array
    scatter_mm: float
    misses_mm: Array
    gap_mm: Array
    gap_error_mm: float

    @property
    def hidden_gap_mm(self) -> float:
        """Standard deviation of a gap hidden in the tip: no accepted gap exceeds three of these."""
        return max(self.gap_error_mm, float(np.linalg.norm(self.gap_mm)) / SURE)


def fit_tip(pairs: TipPairs) -> TipFit:
    """The tip from readings in the divot. Raises CAL-002 to CAL-004, CAL-019."""
    _require_usable(pairs)
    seen = tips_of(pairs)
    tip = seen.mean(axis=0)
    misses = seen - tip
    scatter = max(
        float(np.sqrt(np.sum(misses**2) / (3 * (pairs.count - 1)))),
        LEAST_SCATTER_MM,
    )
    if scatter > LARGEST_SCATTER_MM:
        raise DoesNotFit(
            "the readings do not agree on one tip position",
            limit=f"{LARGEST_SCATTER_MM:g} mm per axis",
            got=f"{beyond(scatter, LARGEST_SCATTER_MM, 2)} mm",
            action="Check that stand, guide and dials are rigid and that x, y and z are not "
            "mixed up; then repeat.",
        )
    gap, gap_error, pivot_scatter = _pivoted_gap(pairs)
    if pivot_scatter > LARGEST_PIVOT_SCATTER_MM:
        raise DoesNotFit(
            "pivoting cannot show whether the divot is where the ball was: the readings scatter too much",
            limit=f"{LARGEST_PIVOT_SCATTER_MM:g} mm per axis",
            got=f"{beyond(pivot_scatter, LARGEST_PIVOT_SCATTER_MM, 3)} mm",
            action="Check that stand, guide and dials are rigid; then repeat.",
        )
    if SURE * gap_error > MOST_OPEN_MM:
        raise DoesNotFit(
            "pivoting cannot show whether the divot is where the ball was: too few "
            "orientations, or too similar",
            limit=f"an uncertainty of {MOST_OPEN_MM:g} mm",
            got=f"{beyond(SURE * gap_error, MOST_OPEN_MM, 2)} mm",
            action="Tilt the guide farther to all sides, or read more orientations; then repeat.",
        )
    limit = max(LARGEST_GAP_MM, SURE * gap_error)
    if np.linalg.norm(gap) > limit:
        raise BallAndDivotApart(
            "according to the pivoting, the divot is not where the ball was",
            limit=f"{limit:.2f} mm",
            got=f"{beyond(float(np.linalg.norm(gap)), limit, 2)} mm",
        )
    covariance = scatter**2 / pairs.count * np.eye(3)
    return TipFit(tip, covariance, scatter, misses, gap, gap_error)


def tips_of(pairs: TipPairs) -> Array:
    """The tip (m, 3) in the tool frame from each reading alone."""
    offsets = _offsets_mm(pairs)
    return np.asarray(np.einsum("mji,mj->mi", pairs.at_divot[:, :3, :3], offsets))


def _require_usable(pairs: TipPairs) -> None:
    action = "Read the dials in more orientations."
    require_count(pairs.count, LEAST_READINGS, "too few readings of the divot", action)
    action = "Tilt the guide by 20 degrees or more to all sides of the divot."
    require_spread(pairs.at_divot[:, :3, :3], "the tip was pivoted over too narrow a cone", action)
    between = pairs.at_ball[:, :3, :3].transpose(0, 2, 1) @ pairs.at_divot[:, :3, :3]
    turned = float(Rotation.from_matrix(between).magnitude().max())
    if turned > SAME_ORIENTATION_RAD:
        raise DoesNotFit(
            "head and tip were not moved there in the same orientation",
            limit=f"{np.degrees(SAME_ORIENTATION_RAD):g} deg",
            got=f"{beyond(math.degrees(turned), math.degrees(SAME_ORIENTATION_RAD), 1)} deg",
        )


def _pivoted_gap(pairs: TipPairs) -> tuple[Array, float, float]:
    """Offset of the divot from the ball, its 3-D standard error, and the scatter per reading and axis.

    Solves `offsets = R tip - gap` for both unknowns.
    """
    rotations, offsets = pairs.at_divot[:, :3, :3], _offsets_mm(pairs)
    rows = np.concatenate([rotations, np.tile(-np.eye(3), (pairs.count, 1, 1))], axis=2).reshape(-1, 6)
    inverse = np.linalg.inv(rows.T @ rows)
    solution = inverse @ rows.T @ offsets.ravel()
    misses = rows @ solution - offsets.ravel()
    variance = max(float(misses @ misses) / (len(misses) - 6), LEAST_SCATTER_MM**2)
    return solution[3:], float(np.sqrt(variance * np.trace(inverse[3:, 3:]))), float(np.sqrt(variance))


def _offsets_mm(pairs: TipPairs) -> Array:
    """From the tool centre at the divot to the ball's position plus the dial readings, (m, 3), robot axes."""
    ball = np.einsum("mij,mj->mi", pairs.at_ball[:, :3, :3], pairs.ball_mm) + pairs.at_ball[:, :3, 3]
    return np.asarray(ball + pairs.dials_mm - pairs.at_divot[:, :3, 3])
