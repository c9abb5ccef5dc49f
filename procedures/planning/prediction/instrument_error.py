"""Contribution of guide and instrument to the target error: direction and play of the bore, the depth stop.

The instrument may be anywhere within the play, independently at the upper and the lower end of the bore. Its
position at an end is uniform in a disc of radius r, half the play, with variance r^2 / 4 along either axis;
beyond the lower end the difference of both grows with distance.

The bore passes through the calibrated position of the mandrel's end, so the effect of a direction error grows
with the distance from there to the target.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.planning.plan.guide_hold import held_trajectory
from procedures.planning.plan.model import Plan, PlannedTrajectory
from ronna_hw.tool_record import GuideBore

Array = NDArray[np.float64]
INSTRUMENT, DIRECTION = "instrument", "guide direction"
SET_BY_HAND_MM = 0.03  # accuracy of setting a depth stop by hand, one standard deviation


def instrument_covariance_mm2(plan: Plan, planned: PlannedTrajectory, bore: GuideBore, held: Array) -> Array:
    """Covariance (3, 3) at the target, for a guide held in an orientation (3, 3), its axis last."""
    share = (plan.standoff_mm + planned.depth_mm) / bore.length_mm  # in bore lengths beyond its lower end
    across_mm2 = (bore.play_mm / 4.0) ** 2 * ((1.0 + share) ** 2 + share**2)
    return np.asarray(held @ np.diag([across_mm2, across_mm2, SET_BY_HAND_MM**2]) @ held.T)


def direction_covariance_mm2(
    plan: Plan, planned: PlannedTrajectory, bore: GuideBore, stated_rad: float, held: Array
) -> Array:
    """The same for the bore's direction, whose error has the standard deviation `stated_rad`."""
    away_mm = held_trajectory(plan, planned, bore).beyond_mm
    across_mm2 = (stated_rad * away_mm) ** 2 / 2.0
    return np.asarray(held @ np.diag([across_mm2, across_mm2, 0.0]) @ held.T)
