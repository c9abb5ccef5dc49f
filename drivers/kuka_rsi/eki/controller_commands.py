"""Everything on the EKI channel that is neither motion nor the RSI stream: tool, base, override."""

from __future__ import annotations

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.eki.controller_state import ControllerState
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.lifecycle import READABLE, Lifecycle, LifecycleGuard
from ronna_hw.wire.kuka_eki import CommandName

AT_REST = (Lifecycle.CONNECTED, Lifecycle.CONFIGURED)  # no active corrections that a new frame could alter
DEFAULT_TIMEOUT_S = 5.0


class ControllerCommands:
    """`arm.controller`. Each call raises EKI-003 without an answer and EKI-008 when refused."""

    def __init__(self, name: str, guard: LifecycleGuard, connections: Connections) -> None:
        self._name = name
        self._guard = guard
        self._connections = connections

    def state(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> ControllerState:
        """The controller's present state."""
        self._guard.require("controller.state", (*READABLE, Lifecycle.FAULT))
        return self._connections.eki.status(timeout_s)

    def set_tool(
        self,
        number: int,
        tool_in_flange: Pose,
        *,
        mass_kg: float,
        centre_of_mass_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Set a tool frame (number 1..16) with its load; at rest only."""
        CX, CY, CZ = centre_of_mass_mm
        frame = _frame(tool_in_flange)
        self._give(CommandName.SET_TOOL, timeout_s, No=number, **frame, M=mass_kg, CX=CX, CY=CY, CZ=CZ)

    def set_base(self, number: int, base_in_world: Pose, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Set a base frame (number 1..32); at rest only."""
        self._give(CommandName.SET_BASE, timeout_s, No=number, **_frame(base_in_world))

    def set_override(self, percent: int, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Program override, 1..100; does not scale RSI corrections."""
        self._give(CommandName.SET_OV, timeout_s, Val=percent)

    def _give(self, command: CommandName, timeout_s: float, **values: object) -> None:
        self._guard.require(f"controller {command}", AT_REST)
        self._connections.eki.require(command, timeout_s, **values)


def _frame(pose: Pose) -> dict[str, object]:
    X, Y, Z, A, B, C = pose.to_kuka()
    values = {"X": X, "Y": Y, "Z": Z, "A": A, "B": B, "C": C}
    return {name: f"{value:.6f}" for name, value in values.items()}
