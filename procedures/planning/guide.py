"""Guide position in front of an entry, depth stop, and the guide's contribution to the target error.

    upper end of the bore            lower end      skin          target
            |--------- length ---------|-- stand-off --|--- depth ---|
    stop ---'------------------- depth stop to tip ------------------'

The tip frame of the guide is that of the mandrel with which it was calibrated, `reach` beyond the lower end.

The instrument may be anywhere within the play, independently at both ends of the bore: uniformly in a disc of
radius r, half the play, with variance r^2 / 4 along either axis. Beyond the lower end the difference of both
grows with distance. As the bore passes through the calibrated end of the mandrel, the effect of a direction
error grows with the distance from there to the target.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from procedures.planning.plan_model import Plan, PlannedTrajectory
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arrays import Array
from ronna_hw.tool_record import GuideBore

SET_BY_HAND_MM = 0.03  # accuracy of setting a depth stop by hand, one standard deviation


def place_guide(plan: Plan, planned: PlannedTrajectory, bore: GuideBore) -> Trajectory:
    """Add the guide's rest position to a trajectory."""
    beyond_mm = bore.reach_mm - plan.standoff_mm - planned.depth_mm
    return planned.trajectory.with_rest(beyond_mm, plan.standoff_mm)


def place_guides(plan: Plan, bore: GuideBore) -> tuple[Trajectory, ...]:
    """Add the guide's rest position to all trajectories of a plan."""
    return tuple(place_guide(plan, one, bore) for one in plan.trajectories)


def depth_stop_mm(plan: Plan, planned: PlannedTrajectory, bore: GuideBore) -> float:
    """Return the distance from the instrument's tip to its depth stop, which rests on the guide, in mm."""
    return bore.length_mm + plan.standoff_mm + planned.depth_mm


def tip_beyond_tool_mm(stop_mm: float, bore_mm: float, reach_mm: float) -> float:
    """Return how far along the axis the tip is from the tool's origin, for a depth stop on the guide.

    `bore_mm` and `reach_mm` are the guide's. Inverse of `depth_stop_mm`: a guide at its rest position has the
    tip at the target.
    """
    return stop_mm - bore_mm - reach_mm


def find_stops_beyond_end(plan: Plan, bore: GuideBore) -> Iterable[tuple[PlannedTrajectory, float]]:
    """Yield trajectories whose depth stop would be beyond the instrument's end, with its position in mm."""
    for one in plan.trajectories:
        stop_mm = depth_stop_mm(plan, one, bore)
        if stop_mm > plan.instrument_length_mm:
            yield one, stop_mm


def instrument_covariance_mm2(
    plan: Plan, planned: PlannedTrajectory, bore: GuideBore, with_rest: Array
) -> Array:
    """Return the target covariance (3, 3) due to play and depth setting, for a guide orientation (3, 3)."""
    share = (plan.standoff_mm + planned.depth_mm) / bore.length_mm  # in bore lengths beyond its lower end
    across_mm2 = (bore.play_mm / 4.0) ** 2 * ((1.0 + share) ** 2 + share**2)
    return np.asarray(with_rest @ np.diag([across_mm2, across_mm2, SET_BY_HAND_MM**2]) @ with_rest.T)


def direction_covariance_mm2(
    plan: Plan, planned: PlannedTrajectory, bore: GuideBore, bore_error_rad: float, with_rest: Array
) -> Array:
    """Return the target covariance (3, 3) due to the bore's direction error (1 sigma)."""
    lever_mm = place_guide(plan, planned, bore).beyond_mm
    across_mm2 = (bore_error_rad * lever_mm) ** 2 / 2.0
    return np.asarray(with_rest @ np.diag([across_mm2, across_mm2, 0.0]) @ with_rest.T)
