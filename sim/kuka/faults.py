"""Fault injection into the controller, arm and EKI channels, with a log of injected faults."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ronna_hw.wire.kuka_eki import OperationMode
from sim.kuka.controller import Controller
from sim.kuka.eki.server import EkiServer, halve, pad_with_nul, prepend_garbage
from sim.kuka.rsi.link import LinkFaults
from sim.kuka.rsi.program_run import RunSettings
from sim.world.faults import Fault, FaultBoard
from sim.world.faults.log import FaultLog
from sim.world.faults.robot import ROBOT_FAULTS
from sim.world.faults.scripted import ScriptedFaults

EKI_FAULTS: dict[str, Callable[[EkiServer], None]] = {
    "eki_cut": EkiServer.drop,
    "eki_overflow": EkiServer.fill_buffer,
    "eki_half": lambda server: server.corrupt_next(halve),
    "eki_garbage": lambda server: server.corrupt_next(prepend_garbage),
    "eki_padding": lambda server: server.corrupt_next(pad_with_nul),
}


class ControllerFaults(ScriptedFaults):
    """Applies the fault script to the controller, once per cycle."""

    def __init__(
        self,
        board: FaultBoard,
        controller: Controller,
        servers: Sequence[EkiServer],
        link: LinkFaults,
        log: FaultLog,
    ) -> None:
        super().__init__(board, log, ROBOT_FAULTS)
        self._controller = controller
        self._servers = servers
        self._link = link
        self._restart: RunSettings | None = None

    def _apply(self, acting: tuple[Fault, ...]) -> None:
        self._link.set_active(acting)
        arguments = {fault.kind.name: fault.argument for fault in acting}
        controller, interlocks = self._controller, self._controller.interlocks
        mode = OperationMode(arguments.get("mode", OperationMode.EXT))
        turned = mode is not interlocks.mode
        if turned:
            controller.turn_key(mode)
        for scripted, present, change in (
            ("emergency_stop" in arguments, interlocks.emergency_stop, controller.press_emergency_stop),
            ("guard" in arguments, interlocks.guard_open, controller.open_guard),
            ("enabling_switch" not in arguments, interlocks.enabling_switch, controller.hold_enabling_switch),
        ):
            if scripted is not present:
                change(scripted)
        key = "start_key" in arguments
        if key is not interlocks.start_key:
            controller.hold_start_key(key)
            turned = True
        if key and interlocks.manual:
            # An operator with the start key in a test mode switches the drives on, and confirms.
            if turned and not controller.drives_on:
                controller.switch_drives(True)
            if controller.run is not None and controller.run.awaits_confirmation:
                controller.acknowledge()
        stick = frozenset(int(fault.argument) - 1 for fault in acting if fault.kind.name == "stick")
        controller.arm.drives.stick(stick)
        controller.is_sensor_dead = "sensor_dead" in arguments
        controller.narrow_corrections(float(arguments["clamp"]) if "clamp" in arguments else None)
        for server in self._servers:
            server.silent = "eki_silence" in arguments
            server.occupied = "eki_taken" in arguments

    def _inject(self, fault: Fault) -> None:
        controller, kind = self._controller, fault.kind.name
        if kind == "trip":
            controller.trip(fault.argument)
        elif kind == "drives_off":
            controller.switch_drives(False)
        elif kind == "collision":
            controller.collide()
        elif kind == "overload":
            controller.overload()
        elif kind == "program_restart":
            if controller.run is not None:
                self._restart = controller.run.settings
                controller.restart()
        else:
            for server in self._servers:
                EKI_FAULTS[kind](server)

    def _settle(self) -> bool:
        """Restart the program where the arm came to rest; return whether that is done."""
        settings = self._restart
        if settings is None:
            return True
        if self._controller.moving:
            return False
        self._restart = None
        if self._controller.run is None:
            self._controller.start(
                settings.cycle_ms,
                settings.relative,
                counts_from_first_reply=settings.counts_from_first_reply,
            )
        return True
