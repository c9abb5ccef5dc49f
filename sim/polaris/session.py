"""Command lines to answers.

Checks run in a fixed order: length and CRC of the line, known name, initialised, mode, then the command's
own checks of its arguments and of the handle. A command that fails a check has no effect.
"""

from __future__ import annotations

from ronna_hw.wire.polaris import REPLY_ERROR
from sim.polaris.framing import ascii_reply, parse_request
from sim.polaris.handlers.table import COMMANDS
from sim.polaris.refusal import ErrorCode, Refusal
from sim.polaris.unit import Mode, Unit


class Session:
    """The conversation of a unit with its hosts. It outlives each of them, as the unit does."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._replies: dict[bytes, bytes] = {}  # to requests for the frame `_replies_frame`
        self._replies_frame = -1
        self.reply_baud = unit.baud  # of the last answer: COMM is answered at the old rate

    def answer(self, line: bytes) -> bytes:
        """The bytes that the unit sends back for one command line (without its CR)."""
        kept = self._replies.get(line)
        if kept is not None and self._unit.frames.number() == self._replies_frame:
            return kept
        self.reply_baud = self._unit.baud
        try:
            answer = self._carry_out(line)
        except Refusal as refusal:
            return ascii_reply(f"{REPLY_ERROR}{refusal.code:02X}")
        return ascii_reply(answer) if isinstance(answer, str) else answer

    def _carry_out(self, line: bytes) -> str | bytes:
        unit = self._unit
        request = parse_request(line)
        name = request.name.upper() if unit.profile.accepts_lower_case else request.name
        command = COMMANDS.get(name)
        if command is None:
            raise Refusal(ErrorCode.UNKNOWN_COMMAND)
        if unit.mode not in command.modes:
            early = unit.mode is Mode.NOT_INITIALISED
            raise Refusal(ErrorCode.NOT_INITIALISED if early else ErrorCode.WRONG_MODE)
        if not command.tells_frame:
            self._replies.clear()
        answer = command.carry_out(unit, request.argument)
        if command.restarts_line:
            self.reply_baud = unit.baud
        if command.tells_frame and unit.frames.repeats and isinstance(answer, bytes):
            self._keep(line, answer)
        return answer

    def _keep(self, line: bytes, reply: bytes) -> None:
        """The same request for the same frame gets the same answer: no need to measure or encode again."""
        number = self._unit.frames.last
        if number != self._replies_frame:
            self._replies.clear()
            self._replies_frame = number
        self._replies[line] = reply
