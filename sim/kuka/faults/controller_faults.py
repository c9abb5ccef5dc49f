"""Faults of interlocks, arm and EKI channels, as currently scripted."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ronna_hw.wire.kuka_eki import OperationMode
from sim.kuka.controller.controller import Controller
from sim.kuka.eki.server import EkiServer, after_garbage, half, padded
from sim.kuka.faults.fault_log import FaultLog
from sim.kuka.faults.link_faults import LinkFaults
from sim.kuka.rsi.program_run import RunSettings
from sim.world.faults import Fault, FaultBoard
from sim.world.faults.robot import ROBOT_FAULTS

MOMENTARY = tuple(kind.name for kind in ROBOT_FAULTS if kind.momentary)
EKI_HAPPENINGS: dict[str, Callable[[EkiServer], None]] = {
    "eki_cut": EkiServer.drop,
    "eki_overflow": EkiServer.overflow,
    "eki_half": lambda server: server.spoil_next(half),
    "eki_garbage": lambda server: server.spoil_next(after_garbage),
    "eki_padding": lambda server: server.spoil_next(padded),
}


class ControllerFaults:
    """Applies the script to the controller, once per cycle."""

    def __init__(
        self,
        board: FaultBoard,
        controller: Controller,
        servers: Sequence[EkiServer],
        link: LinkFaults,
        log: FaultLog,
    ) -> None:
        self._board = board
        self._controller = controller
        self._servers = servers
        self._link = link
        self._log = log
        self._quiet = True
        self._restart: RunSettings | None = None

    def poll(self) -> None:
        """Apply what has become due; no effect without a robot fault in the script."""
        if self._board.empty and self._quiet:
            return
        acting = self._board.acting()
        self._log.look(acting)
        self._link.look(acting)
        arguments = {fault.kind.name: fault.argument for fault in acting}
        controller, interlocks = self._controller, self._controller.interlocks
        mode = OperationMode(arguments.get("mode", OperationMode.EXT))
        turned = mode is not interlocks.mode
        if turned:
            controller.turn_key(mode)
        pressed = "emergency_stop" in arguments
        if pressed is not interlocks.emergency_stop:
            controller.press_emergency_stop(pressed)
        is_open = "guard" in arguments
        if is_open is not interlocks.guard_open:
            controller.open_guard(is_open)
        held = "enabling_switch" not in arguments
        if held is not interlocks.enabling_switch:
            controller.hold_enabling_switch(held)
        key = "start_key" in arguments
        if key is not interlocks.start_key:
            controller.hold_start_key(key)
            turned = True
        if key and interlocks.manual:
            self._attend(newly=turned)
        stick = frozenset(int(fault.argument) - 1 for fault in acting if fault.kind.name == "stick")
        controller.arm.drives.stick(stick)
        controller.narrow_corrections(float(arguments["clamp"]) if "clamp" in arguments else None)
        for server in self._servers:
            server.silent = "eki_silence" in arguments
            server.taken = "eki_taken" in arguments
        for kind in MOMENTARY:
            for fault in self._board.happened(kind):
                self._log.happened(fault)
                self._happen(fault)
        self._start_again()
        self._quiet = not acting and self._restart is None

    def _attend(self, *, newly: bool) -> None:
        """Holding the start key in a test mode includes holding the enabling switch, and confirming."""
        if newly and not self._controller.drives_on:
            self._controller.switch_drives(True)
        run = self._controller.run
        if run is not None and run.awaits_confirmation:
            self._controller.acknowledge()

    def _happen(self, fault: Fault) -> None:
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
                EKI_HAPPENINGS[kind](server)

    def _start_again(self) -> None:
        """A restarted program begins where the arm came to rest."""
        settings = self._restart
        if settings is None or self._controller.moving:
            return
        self._restart = None
        if self._controller.run is None:
            self._controller.start(
                settings.cycle_ms,
                settings.relative,
                counts_from_first_reply=settings.counts_from_first_reply,
            )
