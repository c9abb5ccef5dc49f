"""Faults of the script, applied to controller and connections."""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.wire.universal_robots import CLIENT_REGISTERS, SafetyMode
from sim.universal_robots.connections import ServiceListener
from sim.universal_robots.controller import Controller
from sim.universal_robots.interfaces.clients import ClientInterfaces
from sim.universal_robots.interfaces.dashboard import Dashboard
from sim.universal_robots.loads import NONE
from sim.universal_robots.rtde.server import RtdeServer
from sim.world.faults import Fault, FaultBoard
from sim.world.faults.log import FaultLog
from sim.world.faults.scripted import ScriptedFaults
from sim.world.faults.universal_robots import UR_FAULTS

CLIENT_INPUTS = frozenset(
    f"input_{kind}_register_{number}" for kind in ("int", "double") for number in CLIENT_REGISTERS
)
CONDITIONS = {
    "ur_emergency_stop": SafetyMode.ROBOT_EMERGENCY_STOP,
    "ur_system_emergency_stop": SafetyMode.SYSTEM_EMERGENCY_STOP,
    "ur_safeguard": SafetyMode.SAFEGUARD_STOP,
    "ur_reduced": SafetyMode.REDUCED,
}


class ControllerFaults(ScriptedFaults):
    """Applies the fault script to the controller, once per cycle."""

    def __init__(
        self,
        board: FaultBoard,
        controller: Controller,
        rtde: RtdeServer,
        clients: ClientInterfaces,
        dashboard: Dashboard,
        log: FaultLog,
    ) -> None:
        super().__init__(board, log, UR_FAULTS)
        self._controller = controller
        self._rtde = rtde
        self._clients = clients
        self._dashboard = dashboard
        self._slider: float | None = None  # its place before the fault
        self.frozen = False  # no cycle runs
        self.is_cut = False  # nothing passes

    @property
    def _listeners(self) -> Sequence[ServiceListener]:
        return (self._rtde.listener, self._dashboard.listener, *self._clients.listeners)

    def _apply(self, acting: tuple[Fault, ...]) -> None:
        present = {fault.kind.name: fault.argument for fault in acting}
        arguments = {fault.kind.name: fault.arguments for fault in acting}
        controller = self._controller
        for name, mode in CONDITIONS.items():
            controller.hold(mode, holds=name in present)
        self._rtde.faults.update(
            float(present.get("ur_skip", 0.0)),
            float(present.get("ur_lose", 0.0)),
            int(present.get("ur_late", 0)),
        )
        self._rtde.reserved = CLIENT_INPUTS if "ur_registers_taken" in present else frozenset()
        self._dashboard.silent = "ur_dashboard_silent" in present
        self._turn_local("ur_local" in present)
        loads = controller.loads
        loads.axial_n = float(present.get("ur_load", 0.0))
        tissue = present.get("ur_tissue")
        loads.meet_tissue(None if tissue is None else float(tissue))
        hand = arguments.get("ur_hand")
        loads.hand_n = NONE if hand is None else (float(hand[0]), float(hand[1]), float(hand[2]))
        controller.robot.keeps_load = "ur_load_kept" in present
        self._move_slider(present.get("ur_speed_slider"))
        self.frozen = "ur_frozen" in present
        self.is_cut = "ur_cable" in present
        for listener in self._listeners:
            listener.hold(holds=self.is_cut or self.frozen)
        for link in controller.links:
            link.cut = self.is_cut

    def _turn_local(self, local: bool) -> None:
        """Turn to local or remote mode, which drops the clients that may send scripts, not those of RTDE."""
        modes = self._controller.modes
        if local is not modes.local:
            modes.local = local
            for listener in self._clients.listeners:
                listener.drop_all()

    def _move_slider(self, percent: str | None) -> None:
        robot = self._controller.robot
        if percent is not None:
            if self._slider is None:
                self._slider = robot.speed_fraction
            robot.set_speed_fraction(float(percent) / 100.0)
        elif self._slider is not None:
            robot.set_speed_fraction(self._slider)
            self._slider = None

    def _inject(self, fault: Fault) -> None:
        controller, kind = self._controller, fault.kind.name
        if kind == "ur_protective_stop":
            controller.protective_stop("the arm has touched something")
        elif kind == "ur_violation":
            controller.hold(SafetyMode.VIOLATION)
        elif kind == "ur_fault":
            controller.hold(SafetyMode.FAULT)
        elif kind == "ur_power_off":
            controller.power_off()
        elif kind == "ur_program_stop":
            controller.stop()
        elif kind == "ur_program_pause":
            controller.pause()
        elif kind == "ur_garbage":
            self._rtde.faults.garbage = True
        elif kind == "ur_cut_rtde":
            self._rtde.listener.drop_all()
        else:
            for listener in self._listeners:
                listener.drop_all()
            for link in controller.links:
                link.close()
