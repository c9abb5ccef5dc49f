"""A guide that the journal does not report as held: a lost block may have contained those lines.

If the arm carries the guide, its position is compared with the axis of every registered trajectory, and its
joints with those at the gauge.
"""

from __future__ import annotations

import math

from procedures.engine.engine import Engine
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.positioning import PositionedGuide, insertion_for
from procedures.steps.clinical.results import RegisteredRobot
from procedures.workcell import Insertion, MountedTool
from procedures.workcell.arm_place import stands_at
from procedures.workcell.errors import TipOffAxis

AT_GAUGE_RAD = math.radians(0.5)  # an arm stopped on its way is farther off, or the question is superfluous
AT_START_MM = 1.0  # at the start of the approach it is away; the arm arrives there much more accurately


def guide_on_an_axis(engine: Engine) -> tuple[Insertion, float] | None:
    """The trajectory whose axis the guide is on, and its travel along it in mm."""
    workcell, case = engine.setting.workcell, engine.case
    if workcell.tool is not MountedTool.GUIDE:
        return None
    paths = case.find(CheckedPaths, None)
    if paths is None:
        return None
    tool = workcell.tool_pose()
    for key in engine.order.sequence:
        registered = case.find(RegisteredRobot, key.trajectory)
        led_there = key.name == PositionedGuide.kind and key.trajectory in paths.result.targets
        if not led_there or registered is None:
            continue
        insertion = insertion_for(engine.context(key), registered.result.robot_from_ct.transform)
        try:
            insertion.check_on_axis(tool)
        except TipOffAxis:
            continue
        beyond_mm = insertion.beyond_start_mm(tool)
        if beyond_mm > AT_START_MM:
            return insertion, beyond_mm
    return None


def guide_in_gauge(engine: Engine) -> bool:
    """Whether the arm carries the guide and is where the mandrel is put into the gauge."""
    workcell = engine.setting.workcell
    if workcell.tool is not MountedTool.GUIDE:
        return False
    gauge_rad = tuple(map(math.radians, workcell.tools.guide.gauge.joints_deg))
    return stands_at(workcell.joints_rad(), gauge_rad, AT_GAUGE_RAD)
