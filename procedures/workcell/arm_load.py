"""Load on the arm at rest, as its controller tells."""

from __future__ import annotations

from procedures.calibration.guide_load import Standstill
from ronna_hw.arm.load_model import LoadModel
from ronna_hw.devices import RobotArm
from ronna_hw.devices.axis_loads import LOAD_CYCLES, AxisLoads, TellsLoads
from ronna_hw.devices.readings import Validity
from ronna_hw.vectors import joint_vector


def read_axis_loads(
    arm: RobotArm, cycles: int = LOAD_CYCLES, *, since_rest: bool = False
) -> AxisLoads | None:
    """Average the load signals over so many cycles at rest, or return None if the driver passes none on.

    Raises the errors of `TellsLoads.read_loads`.
    """
    return arm.read_loads(cycles, since_rest=since_rest) if isinstance(arm, TellsLoads) else None


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
