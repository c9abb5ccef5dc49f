"""Faults of the tracker unit, and of the line between unit and host.

Unit faults act before each command: alerts, refusals, delays, wired tools, power loss. Line faults act on
commands and replies: bit errors, lost and doubled bytes, delays. Which command and bit are hit is a function
of seed and command number, so a run repeats. Faults of markers are in
`measurement/true_scene.py`, those of light and strays in `measurement/frame.py`.
"""

from __future__ import annotations

import time
from enum import Enum, auto

import numpy as np

from ronna_hw.wire.polaris import COMMAND_TIMEOUT_S, CR, Alert
from sim.polaris.tracker_unit import SimulatedUnit
from sim.polaris.unit.ports import WiredTool
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode, hexadecimal
from sim.polaris.unit.tool_definition import build_test_definition
from sim.world.noise import noise

LINE_NOISE = "tracker line"

WHOLE_PERCENT = 100.0
USUAL_LIMIT_S = 2.0  # time limit of a host for other commands
BITS = 8


class UnitFaults:
    """Tracker faults applied to a unit, costing one look-up per call when there are none."""

    def __init__(self, unit: SimulatedUnit) -> None:
        self._unit = unit
        self._board = unit.faults
        self._dead = False
        self._alerts = Alert(0)
        self._plugged: set[int] = set()
        self._pulled: set[int] = set()

    @property
    def any_active(self) -> bool:
        """Whether the script has tracker faults, or effects of earlier ones remain to be undone."""
        remains = self._dead or bool(self._alerts or self._plugged or self._pulled)
        return remains or not self._board.empty

    def power(self) -> Power:
        """Return the change in power supply since the previous call."""
        was_dead, self._dead = self._dead, bool(self._board.active("power_off"))
        if self._dead:
            return Power.GONE
        return Power.RETURNS if was_dead or self._board.happened("unit_restart") else Power.STAYS

    def apply(self) -> None:
        """Apply faults that do not depend on a command: alerts and plugging of wired tools."""
        board, unit = self._board, self._unit
        alerts = Alert(sum({1 << int(fault.argument) for fault in board.active("alert")}))
        alerts |= Alert.TOO_HOT if board.active("hot") else Alert(0)
        alerts |= Alert.TOO_COLD if board.active("cold") else Alert(0)
        if alerts != self._alerts:
            unit.alerts.set_lasting(alerts)
            self._alerts = alerts
        if board.happened("bump"):
            unit.alerts.raise_alert(Alert.BUMP)
        self._change_plugs()

    @property
    def watchdog_trips(self) -> bool:
        """Whether a spurious watchdog trip has occurred since the last query."""
        return bool(self._board.happened("watchdog"))

    def apply_to_command(self, name: str, argument: str) -> None:
        """Apply the faults of a command. Raises CommandRefusal if one prevents the command."""
        for fault in self._board.active("slow"):
            if fault.argument == name:
                self._unit.clock.sleep(float(fault.arguments[1]))
        ports = self._unit.ports
        match name:
            case "TSTART":
                if self._board.active("wavelength") and ports.enabled():
                    raise CommandRefusal(NdiErrorCode.WAVELENGTH)
            case "PENA":
                self._refuse_beyond("enabled_limit", len(ports.enabled()), NdiErrorCode.TOO_MANY_ENABLED)
            case "PHRQ":
                self._refuse_beyond("handle_limit", len(list(ports)), NdiErrorCode.NO_HANDLES_LEFT)
            case "PINIT" if self._board.active("corrupt_definitions"):
                port = ports.port(hexadecimal(argument, NdiErrorCode.BAD_HANDLE))
                if not port.initialised:
                    port.memory[-1] ^= 0x01

    def _refuse_beyond(self, kind: str, count: int, code: NdiErrorCode) -> None:
        if any(count >= int(fault.argument) for fault in self._board.active(kind)):
            raise CommandRefusal(code)

    def _change_plugs(self) -> None:
        unit = self._unit
        plugged = {int(fault.argument) for fault in self._board.active("plug")}
        pulled = {int(fault.argument) for fault in self._board.active("unplug")}
        for number in plugged - self._plugged:
            _provide_tool(unit, number)
            unit.plug(number)
        for number in self._plugged - plugged:
            unit.unplug(number)
        for number in (pulled - self._pulled) & unit.wired.plugged:
            unit.unplug(number)
            self._pulled.add(number)
        for number in self._pulled - pulled:
            unit.plug(number)
        self._plugged, self._pulled = plugged, self._pulled & pulled


class Power(Enum):
    """Power supply change."""

    STAYS = auto()
    GONE = auto()
    RETURNS = auto()  # restored after a loss or a dip


def _provide_tool(unit: SimulatedUnit, number: int) -> None:
    """Create a test tool for a socket without one."""
    wired = unit.wired
    wired.count = max(wired.count, number)
    if number not in wired.tools:
        size = unit.behaviour.user_memory_bytes
        wired.tools[number] = WiredTool.from_definition(build_test_definition(), number, size)


class LineFaults:
    """Disturbances of the line between host and unit, costing one look-up per call when there are none."""

    def __init__(self, unit: SimulatedUnit) -> None:
        self._unit = unit
        self._board = unit.faults
        self._count = 0  # commands received during faults

    def to_unit(self, line: bytes) -> bytes:
        """Return a command line as received by the unit."""
        if self._board.empty:
            return line
        self._count += 1
        generator = noise(self._unit.seed, LINE_NOISE, self._count, lane=0)
        return _flip_bit(line, generator) if line and self._strikes("garble_commands", generator) else line

    def to_host(self, line: bytes, reply: bytes) -> bytes:
        """Return a reply as received by the host, possibly delayed, or empty if lost."""
        if self._board.empty:
            return reply
        if not reply:  # the unit has no power
            self._let_host_time_out(line)
            return reply
        generator = noise(self._unit.seed, LINE_NOISE, self._count, lane=1)
        for fault in self._board.active("late_replies"):
            self._wait(float(fault.argument))
        complete = len(reply)
        if self._strikes("garble_replies", generator):
            reply = _flip_bit(reply, generator)
        place = int(generator.integers(len(reply)))
        if self._strikes("double_bytes", generator):
            reply = reply[: place + 1] + reply[place:]
        if self._strikes("drop_bytes", generator):
            reply = reply[:place] + reply[place + 1 :]
        if self._strikes("cut_replies", generator):
            reply = reply[:place]
        if self._strikes("lose_replies", generator):
            reply = b""
        if len(reply) < complete:
            self._let_host_time_out(line)
        return reply

    def _let_host_time_out(self, line: bytes) -> None:
        """Advance an unpaced theatre by the host's time limit, so that faults can end meanwhile."""
        if not self._unit.clock.paced:
            name = line.replace(b":", b" ").partition(b" ")[0].decode("latin-1")
            self._unit.clock.sleep(COMMAND_TIMEOUT_S.get(name, USUAL_LIMIT_S))

    def _wait(self, duration_s: float) -> None:
        """Wait in host time and theatre time, because hosts time out by their own clock."""
        time.sleep(duration_s)
        if not self._unit.clock.paced:
            self._unit.clock.sleep(duration_s)

    def _strikes(self, kind: str, generator: np.random.Generator) -> bool:
        chance = float(generator.random()) * WHOLE_PERCENT
        return any(chance < float(fault.argument) for fault in self._board.active(kind))


def _flip_bit(data: bytes, generator: np.random.Generator) -> bytes:
    """Flip one bit without creating or destroying a CR."""
    damaged = bytearray(data)
    place = int(generator.integers(len(data)))
    bit = int(generator.integers(BITS))
    while damaged[place] ^ (1 << bit) == CR[0]:
        bit = (bit + 1) % BITS
    damaged[place] ^= 1 << bit
    return bytes(damaged)
