"""Command lines to replies.

Checks run in a fixed order: length and CRC of the line, known name, initialised, mode, then the command's own
checks of its arguments and handle. A command that fails a check has no effect.
"""

from __future__ import annotations

import time

from ronna_hw.wire.polaris import REPLY_ERROR, REPLY_OKAY, REPLY_RESET
from sim.polaris.handlers.table import COMMANDS, modes_of_commands
from sim.polaris.line.framing import ascii_reply, parse_request
from sim.polaris.line.line_settings import LineSettings
from sim.polaris.unit.mode import Mode
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit
from sim.polaris.unit.unit_faults import Power, UnitFaults

NANOSECONDS_PER_SECOND = 1_000_000_000
LOOK_S = 0.1  # between checks for events without a command


class CommandInterpreter:
    """Executes the command lines of all hosts, one after another; its state outlives each of them."""

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self.reply_line = unit.line  # settings of the last reply: COMM is answered with the old ones
        self._modes = modes_of_commands(unit.behaviour)
        self._replies: dict[bytes, bytes] = {}  # by request, for frame `_replies_frame`
        self._replies_frame = -1
        self._watch_dog_ns = 0
        self._heard_ns = 0
        self._faults = UnitFaults(unit)
        self._break_s: float | None = None  # host time at which a suspected break is confirmed by silence
        self._starts_s: float | None = None  # host time at which a restarting unit sends RESET

    def reply(self, line: bytes) -> bytes:
        """The reply to one command line (without its CR)."""
        if self._watch_dog_ns:
            self._check_watch_dog()
            self._heard_ns = self.unit.clock.now_ns()
        if self._faults.any_acting and not self._has_power():
            return b""
        kept = self._replies.get(line)
        if kept is not None and self.unit.frames.number() == self._replies_frame:
            return kept
        if self._starts_s is not None:
            return b""  # a unit that is starting does not listen
        self.reply_line = self.unit.line
        try:
            reply = self._carry_out(line)
        except Refusal as refusal:
            return ascii_reply(f"{REPLY_ERROR}{refusal.code:02X}")
        return ascii_reply(reply) if isinstance(reply, str) else reply

    @property
    def line(self) -> LineSettings:
        """Line settings with which the unit listens now."""
        return self.unit.line

    def restart(self, after_s: float | None = None) -> None:
        """Break or power-up: saved settings now, RESET `after_s` later."""
        self.unit.reset()
        self._forget()
        self._watch_dog_ns = 0
        self._starts_s = time.monotonic() + (self.unit.behaviour.reset_s if after_s is None else after_s)

    def suspect_break(self) -> None:
        """The host flushed both directions, as before a break: it is a break if silence follows."""
        self._break_s = time.monotonic() + self.unit.behaviour.break_silence_s

    def deny_break(self) -> None:
        """The host continued talking: there was no break."""
        self._break_s = None

    def host_left(self) -> None:
        """Called when the last host has closed the line."""
        if self.unit.behaviour.line_after_close == "default":
            self.unit.restore_line()

    def due_s(self) -> float:
        """Host time at which `unasked` should be called again."""
        moments_s = (time.monotonic() + LOOK_S, self._break_s, self._starts_s)
        return min(moment_s for moment_s in moments_s if moment_s is not None)

    def unasked(self) -> bytes:
        """What the unit sends unsolicited: RESET after a restart."""
        if self._watch_dog_ns:
            self._check_watch_dog()
        if self._faults.any_acting:
            self._has_power()
        if self._break_s is not None and time.monotonic() >= self._break_s:
            self._break_s = None
            self.restart()
        if self._starts_s is None or time.monotonic() < self._starts_s:
            return b""
        self._starts_s = None
        self.reply_line = self.unit.line
        return ascii_reply(REPLY_RESET)

    def _carry_out(self, line: bytes) -> str | bytes:
        unit = self.unit
        request = parse_request(line)
        name = request.name.upper() if unit.behaviour.accepts_lower_case else request.name
        command = COMMANDS.get(name)
        if command is None:
            raise Refusal(ErrorCode.UNKNOWN_COMMAND)
        if unit.mode not in self._modes[name]:
            early = unit.mode is Mode.NOT_INITIALISED
            raise Refusal(ErrorCode.NOT_INITIALISED if early else ErrorCode.WRONG_MODE)
        if not command.reads_frame:
            self._forget()
        if not unit.faults.empty:
            self._faults.before(name, request.argument)
        command.check(request.argument)
        reply = command.carry_out(unit, request.argument)
        if reply is None:
            reply = REPLY_OKAY
        if command.restarts_line:
            self.reply_line = unit.line
        if not command.reads_frame:
            self._set_watch_dog()
        elif unit.frames.repeats and isinstance(reply, bytes):
            self._cache(line, reply)
        return reply

    def _cache(self, line: bytes, reply: bytes) -> None:
        """Cache a reply: the same request for the same frame gets the same bytes."""
        number = self.unit.frames.last
        if number != self._replies_frame:
            self._replies.clear()
            self._replies_frame = number
        self._replies[line] = reply

    def _forget(self) -> None:
        self._replies.clear()

    def _set_watch_dog(self) -> None:
        self._watch_dog_ns = self.unit.watch_dog_s * NANOSECONDS_PER_SECOND
        self._heard_ns = self.unit.clock.now_ns()

    def _check_watch_dog(self) -> None:
        """Trip the watchdog when the host has been silent for too long."""
        if self.unit.clock.now_ns() - self._heard_ns > self._watch_dog_ns:
            self._trip_watch_dog()

    def _trip_watch_dog(self) -> None:
        """Stop tracking or reset the unit, as configured."""
        self._forget()
        if self.unit.behaviour.watch_dog == "reset":
            self.restart()
        elif self.unit.mode is Mode.TRACKING:
            self.unit.stop()

    def _has_power(self) -> bool:
        """Apply faults; False while the unit has no power."""
        self._forget()
        power = self._faults.power()
        if power is Power.GONE:
            self._starts_s = None
            return False
        if power is Power.RETURNS:
            self.restart()
        self._faults.act()
        if self._faults.host_seems_gone:
            self._trip_watch_dog()
        return True
