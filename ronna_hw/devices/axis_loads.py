"""Load on an arm by its controller's own signals: motor currents, and its estimate of the force on the tool.

An optional capability. An arm that somebody leans on gives way, and its encoders do not show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ronna_hw.devices.readings import Stamp, Validity
from ronna_hw.vectors import JointVector, Vector3

LOAD_CYCLES = 100  # 0.4 s of a KR C4: averages noise to a tenth; friction of the gears remains


@dataclass(frozen=True)
class AxisLoads:
    """Signals of an arm at rest, averaged over `cycles` of its controller; what is not stated is None.

    MISSING: the controller's stream carries none of them. A current is positive if its torque turns the joint
    in the positive direction.
    """

    stamp: Stamp
    validity: Validity
    joints_rad: JointVector
    cycles: int
    current_percent: JointVector | None = None  # of the largest current of each drive
    current_A: JointVector | None = None
    expected_current_A: JointVector | None = None  # by the controller's model, without a force on the tool
    force_N: Vector3 | None = None  # on the tool, in the robot base, as the controller estimates it


@runtime_checkable
class TellsLoads(Protocol):
    """Arm whose driver passes on what the controller knows of the load on each axis."""

    def read_loads(
        self, cycles: int = LOAD_CYCLES, timeout_s: float = 2.0, *, since_rest: bool = False
    ) -> AxisLoads:
        """Average the signals of the next `cycles` cycles at rest. Allowed in ACTIVE and HOLD.

        With `since_rest`: of all cycles since the arm came to rest, at least so many.
        Moves nothing. A stream that carries no signal is MISSING at once. `timeout_s` is host time. Raises
        LinkTimeout if the arm does not rest for so many cycles, and the latched fault.
        """
