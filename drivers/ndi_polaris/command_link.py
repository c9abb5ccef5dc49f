"""NDI command link: CRC framing, time limits, and resynchronisation after disturbances.

Replies carry no number, so a late reply looks like the next one. Therefore input is flushed before each
command; bytes found there, a time-out or a broken reply leave the link *unsettled*. An unsettled link first
sends ECHO with a text of its own and discards everything up to the echo.
"""

from __future__ import annotations

import math
import re
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

from drivers.ndi_polaris.errors import (
    BadReplyCrc,
    LinkLost,
    MalformedReply,
    NoReply,
    NotInitialised,
    UnitError,
    UnitRestarted,
    error_for,
)
from drivers.ndi_polaris.transport import Transport
from ronna_hw.errors import ProtocolError
from ronna_hw.wire import polaris as ndi

CACHED_COMMANDS = 32  # every reading sends the same command
CACHED_HEADERS = 64  # the lengths of a case's replies
TRAILING_TEXT_BYTES = 128  # short texts only: errors, echoes, revisions
BX_START_BYTES = struct.pack("<H", ndi.BX_START)
ORDINARY_REPLY_BYTES = 128  # reply length assumed when computing its transfer time
LONGEST_REPLY_BYTES = 16384  # longer than any reply of these units: beyond this it is noise
LONGEST_LIMIT_S = max(ndi.COMMAND_TIMEOUT_S.values())  # for commands without a limit of their own
QUIET_S = 0.02  # silence after which a line counts as drained
STALL_S = 0.5  # a reply that pauses this long is truncated
BABBLE_BYTES = 1_000_000  # no unit sends this much unasked
ECHO_ATTEMPTS = 3
REFUSALS_NEEDED = 2  # one error may be a late reply to another command, two in a row are not
NOISE_CODES = frozenset({0x01, 0x04})  # wrong CRC, or unknown: a command that lost its colon has no CRC
RESET_TEXT = b"%b%04X\r" % (ndi.REPLY_RESET.encode(), ndi.crc16(ndi.REPLY_RESET.encode()))
Reply = str | bytes  # text of an ASCII reply, body of a binary one
_HEADER = struct.Struct("<HHH")
_CRC = struct.Struct("<H")
_ERROR = re.compile(r"ERROR([0-9A-F]{2})")
_WARNING = re.compile(rf"{ndi.REPLY_WARNING}([0-9A-F]{{2}})?")
_FIRST_BYTES_OF_TEXT = b"ERW"  # ERROR, RESET, WARNING: possible in place of a binary reply


@dataclass
class LineStatistics:
    """Command statistics since the link was opened."""

    commands: int = 0
    retries: int = 0


class _Echo(Enum):
    HEARD = "heard"
    REFUSED = "refused"  # answered with an error
    SILENT = "silent"


class CommandLink:
    """Command link over one transport; not thread-safe."""

    def __init__(
        self,
        transport: Transport,
        *,
        limits_s: Mapping[str, float] = ndi.COMMAND_TIMEOUT_S,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.transport = transport
        self.statistics = LineStatistics()
        self.deadline_s = math.inf  # on the clock `monotonic`: no command waits for longer
        self.waited_s = 0.0  # from the last command to its reply, without the transfer of both
        self._limits_s = limits_s
        self.monotonic = monotonic  # the host's clock, on which deadlines are given
        self._settled = False  # replies to an earlier client may still arrive
        self._silent_since_s: float | None = None
        self._echoes = 0

    def adopt_limits(self, limits_s: Mapping[str, float]) -> None:
        """Override the time limits of the given commands, in seconds."""
        self._limits_s = {**self._limits_s, **limits_s}

    def ask(
        self, name: str, argument: str = "", *, reply_bytes: int = ORDINARY_REPLY_BYTES, retry: bool = True
    ) -> str:
        """Send a command and return the text of its reply, including OKAY and WARNINGhh.

        The time limit is the unit's own for that command plus the transfer at the current rate, bounded by
        `deadline_s`. With `retry` a disturbed exchange is repeated once, so use it only for commands that may
        be repeated. Raises NDI-005 to NDI-009 and the NDI-03x of ERRORhh.
        """
        reply = self._exchange(name, argument, reply_bytes, retry=retry, binary=False)
        assert isinstance(reply, str)
        return reply

    def ask_binary(self, name: str, argument: str = "", *, reply_bytes: int) -> bytes:
        """Send a command as `ask` does and return the body of its binary reply, with CRCs checked."""
        reply = self._exchange(name, argument, reply_bytes, retry=True, binary=True)
        if isinstance(reply, str):
            self._settled = False
            raise MalformedReply(f"text reply to {name}, whose reply is binary", wire=reply.encode())
        return reply

    def limit_s(self, name: str, sent_bytes: int, reply_bytes: int) -> float:
        """Return a command's time limit: the unit's own plus the transfer time both ways."""
        return self._limits_s.get(name, LONGEST_LIMIT_S) + self._transfer_s(sent_bytes + reply_bytes)

    def _transfer_s(self, count: int) -> float:
        baud = self.transport.baud
        return count * ndi.BITS_PER_BYTE_ON_LINE / baud if baud else 0.0

    def drain(self, quiet_s: float = QUIET_S, until_s: float = math.inf) -> bytes:
        """Discard input until the line has been quiet for `quiet_s`; returns the last bytes discarded.

        Raises NDI-006 when the line never falls silent.
        """
        discarded, count = b"", 0
        while data := self.transport.read(quiet_s):
            discarded = (discarded + data)[-LONGEST_REPLY_BYTES:]
            count += len(data)
            if count > BABBLE_BYTES:
                raise MalformedReply("the line never falls silent", wire=discarded)
            if self.monotonic() > until_s:
                break
        return discarded

    def mark_unsettled(self) -> None:
        """Request resynchronisation before the next command."""
        self._settled = False

    def settle(self) -> None:
        """Resynchronise by ECHO with a unique text, discarding everything before the echo.

        A unit without ECHO refuses it twice, which serves equally. Raises NDI-007 while the unit may only be
        slow, NDI-008 when it has been silent beyond its own limits, NDI-009 when it has restarted.
        """
        refusals = 0
        for _ in range(ECHO_ATTEMPTS):
            if RESET_TEXT in self.drain(until_s=self.deadline_s):
                raise UnitRestarted("the unit sent RESET")
            outcome = self._echo()
            refusals = refusals + 1 if outcome is _Echo.REFUSED else 0
            if outcome is _Echo.HEARD or refusals >= REFUSALS_NEEDED:
                self._settled = True
                self._silent_since_s = None
                return
            if self.monotonic() >= self.deadline_s:
                break
        self._raise_silence()

    def _exchange(self, name: str, argument: str, reply_bytes: int, *, retry: bool, binary: bool) -> Reply:
        try:
            return self._exchange_once(name, argument, reply_bytes, binary)
        except (ProtocolError, NoReply, UnitError) as problem:
            is_noise = not isinstance(problem, UnitError) or problem.vendor_code in NOISE_CODES
            if not is_noise or not retry or self.monotonic() >= self.deadline_s:
                raise
        self.statistics.retries += 1
        return self._exchange_once(name, argument, reply_bytes, binary)

    def _exchange_once(self, name: str, argument: str, reply_bytes: int, binary: bool) -> Reply:
        self._check_stale_input()
        command = encode_command(name, argument)
        limit_s = self.limit_s(name, len(command), reply_bytes)
        if not self._settled:
            self.settle()
        self.transport.write(command)
        self.statistics.commands += 1
        started_s = self.monotonic()
        until_s = min(started_s + limit_s, self.deadline_s)
        try:
            reply, rest = self._receive(until_s, binary)
        except ProtocolError:
            self._silent_since_s = None
            self._settled = False
            raise
        if reply is None:
            self._settled = False
            if self._silent_since_s is None:
                self._silent_since_s = started_s
            limit = f"{until_s - started_s:.3f} s"
            raise NoReply(f"no reply to {name}", limit=limit, wire=rest, expected="a reply with CRC")
        self.waited_s = max(0.0, self.monotonic() - started_s - self._transfer_s(len(command) + len(reply)))
        self._silent_since_s = None
        if rest:  # one reply per command: anything more is a duplicate or a late one
            self._settled = False
        if isinstance(reply, str):
            self._raise_unit_error(reply, name)
        return reply

    def _raise_unit_error(self, text: str, name: str) -> None:
        if text == ndi.REPLY_RESET and name != "RESET":
            raise UnitRestarted(f"the unit replied RESET to {name}")
        error = unit_error(text, name)
        if isinstance(error, NotInitialised) and name != "INIT":
            raise UnitRestarted(f"the unit is no longer initialised: it replied {text} to {name}") from error
        if error is not None:
            raise error

    def _receive(self, until_s: float, binary: bool) -> tuple[Reply | None, bytes]:
        """Read a reply until `until_s`; returns (reply or None if incomplete, remaining bytes)."""
        buffer = b""
        while True:
            if binary and buffer[:1] == BX_START_BYTES[:1]:
                if (reply := split_binary(buffer)) is not None:
                    return reply
            elif binary and buffer and buffer[0] not in _FIRST_BYTES_OF_TEXT:
                raise MalformedReply("a binary reply does not start with C4 A5", wire=buffer)
            elif (split := split_ascii_line(buffer)) is not None:
                return decode_ascii(split[0]), split[1]
            if len(buffer) > LONGEST_REPLY_BYTES:
                raise MalformedReply("a reply has no end", limit=f"{LONGEST_REPLY_BYTES} bytes", wire=buffer)
            if (remaining_s := until_s - self.monotonic()) <= 0:
                return None, buffer
            data = self.transport.read(min(remaining_s, STALL_S) if buffer else remaining_s)
            if not data and buffer and remaining_s > STALL_S:
                raise MalformedReply("a reply is truncated", limit=f"{STALL_S} s", wire=buffer)
            buffer += data

    def _check_stale_input(self) -> None:
        """Flush the input before a command; unexpected bytes force a resynchronisation."""
        if not (stale := self.transport.read(0.0)):
            return
        stale += self.drain(0.0)
        self._settled = False
        if RESET_TEXT in stale:
            raise UnitRestarted("the unit sent RESET", wire=stale)

    def _echo(self) -> _Echo:
        self._echoes += 1
        mark = f"INSTEP{self._echoes:06d}"
        command = encode_command("ECHO", mark)
        started_s = self.monotonic()
        self.transport.write(command)
        until_s = min(started_s + self.limit_s("ECHO", len(command), len(command)), self.deadline_s)
        heard = b""
        while (remaining_s := until_s - self.monotonic()) > 0:
            heard = (heard + self.transport.read(remaining_s))[-LONGEST_REPLY_BYTES:]
            if RESET_TEXT in heard:
                raise UnitRestarted("the unit sent RESET", wire=heard)
            if not heard.endswith(b"\r"):
                continue
            if (text := trailing_text(heard[:-1])) is not None and text.endswith(mark):
                return _Echo.HEARD
            if unit_error(text or "", "ECHO") is not None and not self.transport.read(QUIET_S):
                return _Echo.REFUSED
        if heard:
            self._silent_since_s = None
        elif self._silent_since_s is None:
            self._silent_since_s = started_s
        return _Echo.SILENT

    def _raise_silence(self) -> None:
        since_s = self._silent_since_s
        silent_s = self.monotonic() - since_s if since_s is not None else 0.0
        limit_s = max(self._limits_s.get(name, 0.0) for name in ("BX", "TX", "ECHO"))
        limit, got = f"{limit_s:.1f} s", f"{silent_s:.1f} s"
        if silent_s >= limit_s:
            raise LinkLost("the unit is silent", limit=limit, got=got)
        raise NoReply("the link has not resynchronised yet", limit=limit, got=got)


@lru_cache(maxsize=CACHED_COMMANDS)
def encode_command(name: str, argument: str = "") -> bytes:
    """Encode a command as `NAME:argument` + CRC + CR, the form whose CRC the unit checks."""
    text = f"{name}:{argument}".encode("ascii")
    return b"%b%04X\r" % (text, ndi.crc16(text))


def decode_ascii(line: bytes) -> str:
    """Decode an ASCII reply without its CR; raises NDI-005 for a wrong CRC, NDI-006 for non-ASCII bytes."""
    text = line[: -ndi.ASCII_CRC_DIGITS]
    if not _has_valid_crc(line):
        raise BadReplyCrc("wrong CRC in an ASCII reply", expected=f"{ndi.crc16(text):04X}", wire=line)
    try:
        return text.decode("ascii")
    except UnicodeDecodeError as error:
        raise MalformedReply("an ASCII reply contains bytes that are not ASCII", wire=line) from error


def trailing_text(heard: bytes) -> str | None:
    """Find the last reply in bytes that may start with remnants of others; returns its text."""
    line = heard.rsplit(ndi.CR, 1)[-1][-TRAILING_TEXT_BYTES:]
    # A preceding binary reply does not end in CR; the CRC over a complete one is 0, so the text would be
    # valid together with it.
    for start in range(len(line)):
        if line[start:].isascii() and _has_valid_crc(line[start:]):
            return line[start : -ndi.ASCII_CRC_DIGITS].decode("ascii")
    return None


def _has_valid_crc(line: bytes) -> bool:
    # an empty text is legal: an empty parameter list has CRC 0000
    text, digits = line[: -ndi.ASCII_CRC_DIGITS], line[-ndi.ASCII_CRC_DIGITS :]
    return len(digits) == ndi.ASCII_CRC_DIGITS and digits == b"%04X" % ndi.crc16(text)


def split_ascii_line(buffer: bytes) -> tuple[bytes, bytes] | None:
    """Split off the first reply ending in CR as (line without CR, rest), or return None if incomplete."""
    line, end, rest = buffer.partition(ndi.CR)
    return (line, rest) if end else None


def binary_reply_bytes(header: bytes) -> int:
    """Decode the total length of a binary reply from its six-byte header; raises NDI-005 or NDI-006."""
    start, length, crc = _HEADER.unpack_from(header)
    if start != ndi.BX_START:
        raise MalformedReply("a binary reply does not start with C4 A5", wire=header)
    if crc != _header_crc(header[: ndi.BX_HEADER_BYTES - ndi.BX_CRC_BYTES]):
        raise BadReplyCrc("wrong CRC in the header of a binary reply", wire=header[: ndi.BX_HEADER_BYTES])
    return ndi.BX_HEADER_BYTES + int(length) + ndi.BX_CRC_BYTES


@lru_cache(maxsize=CACHED_HEADERS)
def _header_crc(header: bytes) -> int:
    return ndi.crc16(header)


def split_binary(buffer: bytes) -> tuple[bytes, bytes] | None:
    """Split off the first binary reply as (body, rest), or return None if incomplete.

    Raises NDI-005 for a wrong CRC of header or body, NDI-006 for a wrong start sequence.
    """
    if len(buffer) < ndi.BX_HEADER_BYTES:
        return None
    total_bytes = binary_reply_bytes(buffer)
    if len(buffer) < total_bytes:
        return None
    body = buffer[ndi.BX_HEADER_BYTES : total_bytes - ndi.BX_CRC_BYTES]
    (crc,) = _CRC.unpack_from(buffer, total_bytes - ndi.BX_CRC_BYTES)
    if crc != (right := ndi.crc16(body)):
        what = "wrong CRC in the body of a binary reply"
        raise BadReplyCrc(what, expected=f"{right:04X}", wire=buffer[:total_bytes])
    return body, buffer[total_bytes:]


def unit_error(text: str, command: str = "") -> UnitError | None:
    """Build the typed error for an ERRORhh reply, or return None for any other."""
    match = _ERROR.fullmatch(text)
    return error_for(int(match[1], 16), command) if match else None


def warning_meaning(text: str) -> str | None:
    """Return the meaning of a WARNING reply, or None; a warning does not prevent execution."""
    if not (match := _WARNING.fullmatch(text)):
        return None
    if match[1] is None:
        return "a warning without a code (older firmware)"
    return ndi.WARNING_MEANINGS.get(int(match[1], 16), f"undocumented warning {match[1]}")
