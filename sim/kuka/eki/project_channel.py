"""EKI channel of this project: commands, acknowledgements, and unsolicited state messages."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from math import inf
from xml.etree import ElementTree

from ronna_hw.wire import kuka_eki as wire
from ronna_hw.wire.kuka_eki import AckCode, CommandName, Correction, Reference, StateAttribute, StopRequest
from sim.kuka.autostart import Autostart
from sim.kuka.controller import Controller
from sim.kuka.eki.moves import EkiMoves, escape, flag, frame, integer
from sim.kuka.eki.server import EkiServer
from sim.kuka.motion import Acknowledgement
from sim.world.nominal_arm import status_and_turn

MOTIONS = (CommandName.PTP_AXIS, CommandName.PTP_POS, CommandName.LIN)
UNSOLICITED = "0"  # Id of an unsolicited State
CYCLES_MS = (4, 12)
LAST_TOOL, LAST_BASE = 16, 32


class ProjectChannel:
    """Channel for one client; its disconnection ends only the conversation."""

    def __init__(self, server: EkiServer, controller: Controller, autostart: Autostart) -> None:
        self._server = server
        self._controller = controller
        self._autostart = autostart
        self._next_state_s = 0.0
        self._idle_until_s = inf  # for a client that has not requested anything yet
        self._sent: tuple[str, ...] = ()
        self._motion_name = self._motion_id = ""
        moves = EkiMoves(controller, self._report_motion_end)
        self._handlers: dict[str, Callable[[Mapping[str, str]], Acknowledgement]] = {
            CommandName.RSI_START: self._rsi_start,
            CommandName.RSI_STOP: self._rsi_stop,
            CommandName.DRIVES: lambda arguments: controller.switch_drives(flag(arguments, "On")),
            CommandName.SET_OV: lambda arguments: controller.set_override(integer(arguments, "Val")),
            CommandName.SET_TOOL: lambda arguments: controller.set_tool(
                _parse_number(arguments, LAST_TOOL), frame(arguments)
            ),
            CommandName.SET_BASE: lambda arguments: controller.set_base(
                _parse_number(arguments, LAST_BASE), frame(arguments)
            ),
            CommandName.STOP: self._stop,
            CommandName.ACK_ERRORS: lambda _: controller.acknowledge(),
            CommandName.SELECT: lambda _: controller.select(),
            CommandName.CANCEL: self._rsi_stop,
            CommandName.PTP_AXIS: moves.ptp_axis,
            CommandName.PTP_POS: moves.ptp_pos,
            CommandName.LIN: moves.lin,
        }
        server.attach(self)

    def client_connected(self) -> None:
        """Send the state to a newly connected client."""
        self._sent = ()
        self._idle_until_s = time.monotonic() + self._controller.parameters.first_request_s
        self.tick(time.monotonic())

    def client_disconnected(self) -> None:
        """Handle the loss of the client, which cancels a running program only if a parameter says so."""
        self._autostart.arm()
        self._controller.handle_eki_loss()

    def request(self, element: ElementTree.Element) -> None:
        """Answer a command and ignore anything else."""
        if element.tag != wire.CMD:
            return
        self._idle_until_s = inf
        identifier, name = element.get("Id", UNSOLICITED), element.get("Name", "")
        if name == CommandName.STATUS:
            self._server.send(self._compose_state(identifier))
            return
        handler = self._handlers.get(name)
        try:
            answer = (
                handler(element.attrib)
                if handler is not None
                else Acknowledgement(AckCode.BAD_VALUE, f"unknown command {name}")
            )
        except ValueError as mistake:
            answer = Acknowledgement(AckCode.BAD_VALUE, str(mistake))
        if name in MOTIONS and answer.code is AckCode.OK:
            self._motion_name, self._motion_id = name, identifier
        self._acknowledge(identifier, name, answer)
        self.tick(time.monotonic())

    def _report_motion_end(self, answer: Acknowledgement) -> None:
        """Acknowledge a motion a second time, when it completes or is aborted."""
        self._acknowledge(self._motion_id, self._motion_name, answer)

    def _acknowledge(self, identifier: str, name: str, answer: Acknowledgement) -> None:
        self._server.send(
            f'<{wire.ACK} Id="{self._escape(identifier)}" Cmd="{self._escape(name)}"'
            f' Code="{answer.code.value}" Text="{self._escape(answer.text)}"></{wire.ACK}>'
        )

    def tick(self, now_s: float) -> float:
        """Send the state if changed or due, and return the time of the next call."""
        if self._server.connected and now_s > self._idle_until_s and not self._server.silent:
            self._server.drop()  # by the program; a silent one does nothing
        if not self._server.connected:
            return inf
        facts = self._collect_facts()
        if facts != self._sent or now_s >= self._next_state_s:
            self._sent = facts
            self._next_state_s = now_s + wire.STATE_PERIOD_MS / 1000.0
            self._server.send(self._compose_state(UNSOLICITED))
        return self._next_state_s

    # -- state

    def _collect_facts(self) -> tuple[str, ...]:
        controller = self._controller
        facts: tuple[str | int, ...] = (
            controller.interlocks.mode.value,
            controller.drives_on,
            controller.interlocks.emergency_stop,
            controller.interlocks.guard_open,
            controller.program_state.value,
            controller.moving,
            controller.override_percent,
            controller.message.number if controller.message else 0,
            controller.rsi_state.value,
            controller.mounted_tool(),
            controller.arm.base_number,
            controller.message is not None,
            (Reference.RELATIVE if controller.relative else Reference.ABSOLUTE).value,
            controller.holds_corrections,
            controller.cycle_ms,
            controller.context_hash,
            controller.arm.description.variant,
            controller.parameters.serial_number,
            controller.open_brakes if controller.parameters.reports_brakes else "",
        )
        return tuple(fact if isinstance(fact, str) else str(int(fact)) for fact in facts)

    def _compose_state(self, identifier: str) -> str:
        values = (self._escape(identifier), *self._collect_facts())
        head = " ".join(f'{name}="{value}"' for name, value in zip(StateAttribute, values, strict=True))
        arm = self._controller.arm
        axes = " ".join(
            f'{name}="{angle:.4f}"'
            for name, angle in zip(wire.AXIS_ATTRIBUTES, arm.reported_deg, strict=True)
        )
        status, turn = status_and_turn(arm.description, arm.reported_deg)
        status ^= self._controller.parameters.inverted_status
        places = (*(f"{value:.4f}" for value in arm.reported_frame), str(status), str(turn))
        position = " ".join(
            f'{name}="{value}"' for name, value in zip(wire.POS_ATTRIBUTES, places, strict=True)
        )
        parts = f"<{wire.AXIS} {axes}></{wire.AXIS}><{wire.POS} {position}></{wire.POS}>"
        return f"<{wire.STATE} {head}>{parts}</{wire.STATE}>"

    def _escape(self, content: str) -> str:
        return escape(content, self._controller.parameters.longest_text)

    # -- commands

    def _rsi_start(self, arguments: Mapping[str, str]) -> Acknowledgement:
        cycle_ms = integer(arguments, "Cycle") if "Cycle" in arguments else None
        if cycle_ms is not None and cycle_ms not in CYCLES_MS:
            raise ValueError("Cycle is 4 or 12")
        relative = Reference(arguments["Ref"]) is Reference.RELATIVE if "Ref" in arguments else None
        correction = Correction(arguments["Corr"]).value if "Corr" in arguments else None
        self._autostart.yield_to_client()
        return self._controller.start(cycle_ms, relative, correction)

    def _rsi_stop(self, _: Mapping[str, str]) -> Acknowledgement:
        self._autostart.disarm()
        return self._controller.cancel()

    def _stop(self, arguments: Mapping[str, str]) -> Acknowledgement:
        kind = StopRequest(arguments.get("Kind", StopRequest.PATH))
        self._autostart.disarm()
        return self._controller.stop(fast=kind is StopRequest.FAST)


def _parse_number(arguments: Mapping[str, str], last: int) -> int:
    number = integer(arguments, "No")
    if not 1 <= number <= last:
        raise ValueError(f"No is 1 to {last}")
    return number
