"""Where a guide stops before the skin, and the instrument length from there to the target.

    upper end of the bore            lower end      skin          target
            |--------- length ---------|-- stand-off --|--- depth ---|
    stop ---'------------------- depth stop to tip ------------------'

The tip frame of the guide is that of the mandrel with which it was calibrated, `reach` beyond the lower end.
"""

from __future__ import annotations

from collections.abc import Iterable

from procedures.planning.plan.model import Plan, PlannedTrajectory
from procedures.strategies.trajectory import Trajectory
from ronna_hw.tool_record import GuideBore


def held_trajectory(plan: Plan, planned: PlannedTrajectory, bore: GuideBore) -> Trajectory:
    """The trajectory, with the rest position of the tip frame on it while the guide is held outside."""
    beyond_mm = bore.reach_mm - plan.standoff_mm - planned.depth_mm
    return planned.trajectory.held(beyond_mm, plan.standoff_mm)


def held_trajectories(plan: Plan, bore: GuideBore) -> tuple[Trajectory, ...]:
    """All trajectories of a plan."""
    return tuple(held_trajectory(plan, one, bore) for one in plan.trajectories)


def depth_stop_mm(plan: Plan, planned: PlannedTrajectory, bore: GuideBore) -> float:
    """From the instrument's tip to the stop that rests on the guide when the tip is at the target."""
    return bore.length_mm + plan.standoff_mm + planned.depth_mm


def too_short(plan: Plan, bore: GuideBore) -> Iterable[tuple[PlannedTrajectory, float]]:
    """The trajectories whose depth stop would be beyond the instrument's end, and where."""
    for one in plan.trajectories:
        stop_mm = depth_stop_mm(plan, one, bore)
        if stop_mm > plan.instrument_length_mm:
            yield one, stop_mm
