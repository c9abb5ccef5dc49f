"""Command interpreter: executes command lines and returns the unit's replies.

Checks run in a fixed order: length and CRC of the line, known name, initialised, mode, then the command's own
checks of its arguments and handle. A refused command has no effect.
"""

from __future__ import annotations

import time

from ronna_hw.wire.polaris import REPLY_ERROR, REPLY_OKAY, REPLY_RESET
from sim.polaris.faults import Power, UnitFaults
from sim.polaris.handlers.table import COMMANDS, modes_of_commands
from sim.polaris.tracker_unit import SimulatedUnit, UnitMode
from sim.polaris.unit.framing import DEFAULT_LINE, ascii_reply, parse_request
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode

NANOSECONDS_PER_SECOND = 1_000_000_000
POLL_S = 0.1  # between checks for events that need no command


class CommandInterpreter:
    """Executes command lines from successive hosts."""

    def __init__(self, unit: SimulatedUnit) -> None:
        self.unit = unit
        self.reply_line = unit.line  # settings for the last reply: COMM is answered with the old ones
        self._modes = modes_of_commands(unit.behaviour)
        self._replies: dict[bytes, bytes] = {}  # by request, for frame `_replies_frame`
        self._replies_frame = -1
        self._watch_dog_ns = 0
        self._heard_ns = 0
        self._faults = UnitFaults(unit)
        self._break_s: float | None = None  # host time at which a suspected break is confirmed by silence
        self._starts_s: float | None = None  # host time at which a restarting unit sends RESET

    def reply(self, line: bytes) -> bytes:
        """Execute a command line (without CR) and return the reply, which is empty without power."""
        if self._watch_dog_ns:
            self._check_watch_dog()
            self._heard_ns = self.unit.clock.now_ns()
        if self._faults.any_active and not self._has_power():
            return b""
        kept = self._replies.get(line)
        if kept is not None and self.unit.frames.number() == self._replies_frame:
            return kept
        if self._starts_s is not None:
            return b""  # the unit does not listen while it starts
        self.reply_line = self.unit.line
        try:
            reply = self._carry_out(line)
        except CommandRefusal as refusal:
            return ascii_reply(f"{REPLY_ERROR}{refusal.code:02X}")
        return ascii_reply(reply) if isinstance(reply, str) else reply

    def restart(self, after_s: float | None = None) -> None:
        """Restart after a break or at power-up: restore saved settings now and send RESET after `after_s`."""
        self.unit.reset()
        self._replies.clear()
        self._watch_dog_ns = 0
        self._starts_s = time.monotonic() + (self.unit.behaviour.reset_s if after_s is None else after_s)

    def note_possible_break(self) -> None:
        """Record a flush of both directions, which counts as a break if silence follows."""
        self._break_s = time.monotonic() + self.unit.behaviour.break_silence_s

    def dismiss_break(self) -> None:
        """Discard a suspected break, because the host has sent more data."""
        self._break_s = None

    def host_left(self) -> None:
        """Handle the departure of the last host."""
        if self.unit.behaviour.line_after_close == "default":
            self.unit.line = DEFAULT_LINE

    def due_s(self) -> float:
        """Return the host time at which to call `unsolicited_bytes` again."""
        moments_s = (time.monotonic() + POLL_S, self._break_s, self._starts_s)
        return min(moment_s for moment_s in moments_s if moment_s is not None)

    def unsolicited_bytes(self) -> bytes:
        """Return any unsolicited output now due, such as RESET after a restart."""
        if self._watch_dog_ns:
            self._check_watch_dog()
        if self._faults.any_active:
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
            raise CommandRefusal(NdiErrorCode.UNKNOWN_COMMAND)
        if unit.mode not in self._modes[name]:
            early = unit.mode is UnitMode.NOT_INITIALISED
            raise CommandRefusal(NdiErrorCode.NOT_INITIALISED if early else NdiErrorCode.WRONG_MODE)
        if not command.reads_frame:
            self._replies.clear()
        if not unit.faults.empty:
            self._faults.apply_to_command(name, request.argument)
        command.check(request.argument)
        reply = command.carry_out(unit, request.argument)
        if reply is None:
            reply = REPLY_OKAY
        if command.restarts_line:
            self.reply_line = unit.line
        if not command.reads_frame:
            self._watch_dog_ns = unit.watch_dog_s * NANOSECONDS_PER_SECOND
            self._heard_ns = unit.clock.now_ns()
        elif unit.frames.repeats and isinstance(reply, bytes):
            self._cache(line, reply)
        return reply

    def _cache(self, line: bytes, reply: bytes) -> None:
        """Cache a reply for identical requests within the same frame."""
        number = self.unit.frames.last
        if number != self._replies_frame:
            self._replies.clear()
            self._replies_frame = number
        self._replies[line] = reply

    def _check_watch_dog(self) -> None:
        """Trip the watchdog if the host has been silent for too long."""
        if self.unit.clock.now_ns() - self._heard_ns > self._watch_dog_ns:
            self._trip_watch_dog()

    def _trip_watch_dog(self) -> None:
        """Stop tracking, or reset the unit if so configured."""
        self._replies.clear()
        if self.unit.behaviour.watch_dog == "reset":
            self.restart()
        elif self.unit.mode is UnitMode.TRACKING:
            self.unit.stop()

    def _has_power(self) -> bool:
        """Apply faults and return whether the unit has power."""
        self._replies.clear()
        power = self._faults.power()
        if power is Power.GONE:
            self._starts_s = None
            return False
        if power is Power.RETURNS:
            self.restart()
        self._faults.apply()
        if self._faults.watchdog_trips:
            self._trip_watch_dog()
        return True
