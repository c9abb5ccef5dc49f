"""Load on the guide as it comes to rest, by the controller's own signals.

Encoders do not see an arm give way under a hand that leans on it from before the guide's rest position is
measured. The tracker does, within what it resolves; motor currents and forces are evidence of another kind,
and the only one where the tracker does not see the frame on the arm.
"""

from __future__ import annotations

from procedures.calibration.guide_load import LoadEstimate, Standstill, estimate_load
from procedures.engine.context import StepContext
from procedures.guards.errors import RoomUndecided
from procedures.workcell import MountedTool, Workcell
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.load_model import LoadModel
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.readings import Validity
from ronna_hw.vectors import joint_vector, vector3

CYCLES = 25  # averaged: a tenth of a second of a KR C4; friction of the gears decides, not noise
LET_GO = (
    "Let go of guide and arm, and see that no cable or drape pulls at them. Send the arm home, then run the "
    "step again."
)


class UnloadedStops(list[Standstill]):
    """Stops of the arm at which nobody leaned on it, with the signals of its load."""


def note_unloaded(context: StepContext) -> None:
    """Read the load at a stop where the room was found in place."""
    if (stop := _read(context.workcell)) is None:
        return
    memory = context.setting.memory
    memory.keep(UnloadedStops([*(memory.find(UnloadedStops) or ()), stop]))


def require_unloaded(context: StepContext) -> LoadEstimate | None:
    """Return the load on the held guide, None if the controller tells too little. Raises PRO-052 for one."""
    workcell, known = context.workcell, context.setting.memory.find(UnloadedStops)
    arm = workcell.master.arm.kinematics
    now, model = _read(workcell), find_arm(arm.name).load
    if now is None or known is None or model is None:
        return None
    bore = workcell.tools.guide.bore
    end_mm = workcell.master.flange_from(MountedTool.GUIDE).apply((0.0, 0.0, -bore.reach_mm))
    load = estimate_load(arm, model, known, now, vector3(end_mm))
    if load.is_loaded:
        x, y, z = load.force_N.tolist()
        raise RoomUndecided(
            f"at {context.trajectory} the controller's own signals show a load on the arm (x {x:+.0f}, "
            f"y {y:+.0f}, z {z:+.0f} N at the guide, in the robot frame)",
            limit=f"{load.noticed_from_N:.0f} N",
            got=f"{(x * x + y * y + z * z) ** 0.5:.0f} N",
            action=LET_GO,
        )
    return load


def _read(workcell: Workcell) -> Standstill | None:
    master = workcell.master
    if not master.streaming:
        return None
    model = find_arm(master.arm.kinematics.name).load
    return as_standstill(master.read_load(CYCLES), model, str(master.tool))


def as_standstill(loads: AxisLoads | None, model: LoadModel | None, tool: str) -> Standstill | None:
    """Return what the estimate needs, or None without fresh signals or assumptions on this model of arm."""
    if loads is None or model is None or loads.validity is not Validity.OK:
        return None
    signal = loads.current_percent or loads.current_A
    if signal is not None and model.subtracts_gravity:
        if (expected := loads.expected_current_A) is None:
            return None
        signal = joint_vector(x - y for x, y in zip(signal, expected, strict=True))
    return None if signal is None else Standstill(loads.joints_rad, signal, loads.cycles, tool, loads.force_N)
