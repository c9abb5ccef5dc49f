"""What guide and instrument add to the error at the target: direction and play of the bore, the depth stop.

It may lie anywhere in the play, at the upper and at the lower end of the bore on its own. Its place at an end
is uniform in a disc of radius r, half the play, whose variance along either axis is r^2 / 4; beyond the lower
end the difference of both grows with the distance.

The bore leads through the calibrated place of the mandrel's end, so an error of its direction grows with the
distance from there to the target.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.planning.plan.guide_hold import held_trajectory
from procedures.planning.plan.model import Plan, PlannedTrajectory
from ronna_hw.tool_record import GuideBore

Array = NDArray[np.float64]
INSTRUMENT, DIRECTION = "instrument", "guide direction"
SET_BY_HAND_MM = 0.03  # how exactly hands set a depth stop, one standard deviation


def instrument_covariance_mm2(plan: Plan, planned: PlannedTrajectory, bore: GuideBore, held: Array) -> Array:
    """Covariance (3, 3) at the target, of a guide held in an orientation (3, 3) with its axis last."""
    share = (plan.standoff_mm + planned.depth_mm) / bore.length_mm  # of the bore, beyond its lower end
    across_mm2 = (bore.play_mm / 4.0) ** 2 * ((1.0 + share) ** 2 + share**2)
    return np.asarray(held @ np.diag([across_mm2, across_mm2, SET_BY_HAND_MM**2]) @ held.T)


def direction_covariance_mm2(
    plan: Plan, planned: PlannedTrajectory, bore: GuideBore, stated_rad: float, held: Array
) -> Array:
    """The same of the bore's direction, of whose error `stated_rad` is one standard deviation."""
    away_mm = held_trajectory(plan, planned, bore).beyond_mm
    across_mm2 = (stated_rad * away_mm) ** 2 / 2.0
    return np.asarray(held @ np.diag([across_mm2, across_mm2, 0.0]) @ held.T)
