"""The head's position for the way home after a restart: the valid one, or else the last valid one."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.engine.engine import Engine
from procedures.engine.errors import RecoveryRefused
from procedures.engine.run_folder import typed
from procedures.engine.step import StepKey
from procedures.recovery.calibration import surround_calibration
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import RegisteredRobot, Relocalization
from procedures.steps.clinical.surroundings import surround_guide, surround_stereo_head
from procedures.workcell import MountedTool
from ronna_hw.frames import Transform

MOVED_SINCE = (
    "something has moved since the guide was positioned: on its way out it keeps clear of the head's "
    "former position"
)


def surround(engine: Engine) -> None:
    """Set the head's position before anything moves. If it is not known yet, the arm is still home.

    Raises PRO-032 for an arm away from home if no result gives it.
    """
    workcell, keys = engine.setting.workcell, engine.order.sequence
    if engine.setting.clinical is None:
        surround_calibration(engine)
    elif workcell.tool is MountedTool.STEREO_HEAD and engine.case.find(Correspondence, None) is not None:
        over = next(key for key in keys if key.name == Relocalization.kind)
        surround_stereo_head(engine.context(over), workcell.joints_rad())  # where the way out begins
    elif (led := _led(engine)) is not None:
        surround_guide(engine.context(led.key), led.robot_from_ct, workcell.joints_rad())
    elif not workcell.place.is_home:
        raise RecoveryRefused(
            "the arm is not home, and no result gives the position of the head",
            action="Jog the arm home with the controller's pendant, then resume again.",
        )


def head_moved_since(engine: Engine) -> bool:
    """Whether the guide must leave by a registration that is no longer valid."""
    return (led := _led(engine)) is not None and not led.holds


@dataclass(frozen=True)
class _Led:
    """The registration that led the guide, or would have led it there."""

    key: StepKey  # of the step that positions the guide
    robot_from_ct: Transform
    holds: bool


def _led(engine: Engine) -> _Led | None:
    """For the trajectory that the guide is on, if any: the valid one, else the last valid one."""
    workcell, case = engine.setting.workcell, engine.case
    if workcell.tool is not MountedTool.GUIDE:
        return None
    on = workcell.place.trajectory
    keys = [key for key in engine.order.sequence if key.name == PositionedGuide.kind]
    keys = [key for key in keys if on in (None, key.trajectory)]
    for key in keys:
        registered = case.find(RegisteredRobot, key.trajectory)
        if registered is not None and registered.record.identifier not in case.past:
            return _Led(key, registered.result.robot_from_ct.transform, holds=True)
    made = [record for record in case.records if record.kind == RegisteredRobot.kind]
    for record in reversed(made):
        for key in keys:
            if record.trajectory in (None, key.trajectory):
                former = typed(record, RegisteredRobot)
                return _Led(key, former.robot_from_ct.transform, holds=False)
    return None
