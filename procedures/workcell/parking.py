"""Leads the arm away from the head and home, each motion confirmed by the operator before it."""

from __future__ import annotations

from procedures.operator.question import Topic
from procedures.workcell.insertion import Insertion
from procedures.workcell.workcell import Workcell
from ronna_hw.devices.readings import ArmReading


def withdraw(workcell: Workcell, on: Insertion, trajectory: str) -> None:
    """Back along the axis on which the guide is. Raises PRO-002, and what `Workcell.withdraw` raises."""
    workcell.start()
    way_out = [workcell.withdrawing(on)]
    workcell.supervised.confirm(Topic.RETREAT, f"retreat from {trajectory}", way_out, trajectory)
    workcell.withdraw(trajectory)


def park(workcell: Workcell, subject: str = "park the arm") -> ArmReading:
    """Home, or back there along the way the arm came. Raises PRO-002, and what a motion raises."""
    workcell.start()
    workcell.supervised.confirm(Topic.PARK, subject, [workcell.returning_home()])
    return workcell.return_home()
