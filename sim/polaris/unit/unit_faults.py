"""Faults of the unit itself: alerts, refusals, delays, tools on cables, power loss.

They act before each command. Faults of markers and light are in `scene/disturbance.py`, those of the line to
the host in `line/line_faults.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto

from ronna_hw.wire.polaris import Alert
from sim.polaris.handlers.arguments import hexadecimal
from sim.polaris.tools.definition import wiring_definition
from sim.polaris.tools.ports import Port
from sim.polaris.tools.wired_tools import WiredTool
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit


class Power(Enum):
    """State of the power supply."""

    STAYS = auto()
    GONE = auto()
    RETURNS = auto()  # restored after a loss or a dip


class UnitFaults:
    """The tracker's faults applied to a unit. Costs one look-up if there are none."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._board = unit.faults
        self._dead = False
        self._alerts = Alert(0)
        self._plugged: set[int] = set()
        self._pulled: set[int] = set()
        self._refusals: dict[str, Callable[[str], None]] = {
            "TSTART": self._start,
            "PENA": self._enable,
            "PHRQ": self._request,
            "PINIT": self._initialise,
        }

    @property
    def any_acting(self) -> bool:
        """Whether the script has a tracker fault, or one has yet to end."""
        left = self._dead or bool(self._alerts or self._plugged or self._pulled)
        return left or not self._board.empty

    def power(self) -> Power:
        """What happened to the supply since the previous call."""
        was_dead, self._dead = self._dead, bool(self._board.active("power_off"))
        if self._dead:
            return Power.GONE
        return Power.RETURNS if was_dead or self._board.happened("unit_restart") else Power.STAYS

    def act(self) -> None:
        """Apply the faults that need no command: alerts, tools on cables."""
        board, unit = self._board, self._unit
        alerts = Alert(sum({1 << int(fault.argument) for fault in board.active("alert")}))
        alerts |= Alert.TOO_HOT if board.active("hot") else Alert(0)
        alerts |= Alert.TOO_COLD if board.active("cold") else Alert(0)
        if alerts != self._alerts:
            unit.alerts.impose(alerts)
            self._alerts = alerts
        if board.happened("bump"):
            unit.alerts.raise_alert(Alert.BUMP)
        self._change_plugs()

    @property
    def host_seems_gone(self) -> bool:
        """True once for each spurious watchdog trip."""
        return bool(self._board.happened("watchdog"))

    def before(self, name: str, argument: str) -> None:
        """Apply the faults of a command; raises Refusal when one prevents it."""
        for fault in self._board.active("slow"):
            if fault.argument == name:
                self._unit.take_time(float(fault.arguments[1]))
        refusal = self._refusals.get(name)
        if refusal is not None:
            refusal(argument)

    def _start(self, _argument: str) -> None:
        if self._board.active("wavelength") and self._unit.ports.enabled():
            raise Refusal(ErrorCode.WAVELENGTH)

    def _enable(self, _argument: str) -> None:
        self._refuse_beyond("enabled_limit", len(self._unit.ports.enabled()), ErrorCode.TOO_MANY_ENABLED)

    def _request(self, _argument: str) -> None:
        self._refuse_beyond("handle_limit", len(list(self._unit.ports)), ErrorCode.NO_HANDLES_LEFT)

    def _initialise(self, argument: str) -> None:
        if self._board.active("corrupt_definitions"):
            _corrupt(self._unit.ports.port(hexadecimal(argument, ErrorCode.BAD_HANDLE)))

    def _refuse_beyond(self, kind: str, count: int, code: ErrorCode) -> None:
        if any(count >= int(fault.argument) for fault in self._board.active(kind)):
            raise Refusal(code)

    def _change_plugs(self) -> None:
        """Plug and unplug tools on cables as scripted."""
        unit = self._unit
        plugged = {int(fault.argument) for fault in self._board.active("plug")}
        pulled = {int(fault.argument) for fault in self._board.active("unplug")}
        for number in plugged - self._plugged:
            _lay_ready(unit, number)
            unit.plug(number)
        for number in self._plugged - plugged:
            unit.unplug(number)
        for number in (pulled - self._pulled) & unit.wired.plugged:
            unit.unplug(number)
            self._pulled.add(number)
        for number in self._pulled - pulled:
            unit.plug(number)
        self._plugged, self._pulled = plugged, self._pulled & pulled


def _corrupt(port: Port) -> None:
    """Flip a bit in the memory of a handle."""
    if not port.initialised:
        port.memory[-1] ^= 0x01


def _lay_ready(unit: Unit, number: int) -> None:
    """Provide a test tool for a socket that has none."""
    wired = unit.wired
    wired.count = max(wired.count, number)
    if number not in wired.tools:
        size = unit.behaviour.user_memory_bytes
        wired.tools[number] = WiredTool.from_definition(wiring_definition(), number, size)
