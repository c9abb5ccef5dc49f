"""Request and reply framing, and serial line settings.

A request is `NAME:args` + CRC, `NAME args`, or the bare name; all end in CR.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from functools import lru_cache

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import ASCII_CRC_DIGITS, BX_START, CR, crc16
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode

CACHED_HEADERS = 64  # lengths of the replies of a case
STALE_S = 1.0  # half a command this old came from a client that disappeared
STRAY_LINE_FEED = b"\n"  # from clients that end a line with CR LF
_SEPARATOR = re.compile(rb"[: ]")
_FOUR_DIGITS = re.compile(rb"[0-9A-Fa-f]{4}")
_U16 = struct.Struct("<H")
_HEADER = struct.Struct("<HH")


@dataclass(frozen=True)
class LineSettings:
    """Baud rate, bits, parity, stop bits and handshake (COMM), ignored on a TCP connection."""

    baud: int
    data_bits: int = 8
    parity: str = "none"
    stop_bits: int = 1
    handshake: str = "off"

    @classmethod
    def from_argument(cls, argument: str) -> LineSettings:
        """Parse the argument of COMM; raises KeyError for an unknown code."""
        baud, data, parity, stop, handshake = tuple(argument)
        return cls(
            wire.COMM_BAUD_CODES[baud],
            wire.COMM_DATA_BITS[data],
            wire.COMM_PARITY[parity],
            wire.COMM_STOP_BITS[stop],
            wire.COMM_HANDSHAKE[handshake],
        )

    @property
    def seconds_per_byte(self) -> float:
        """Transfer time of one byte in seconds, including start, parity and stop bits."""
        return (1 + self.data_bits + (self.parity != "none") + self.stop_bits) / self.baud


DEFAULT_LINE = LineSettings.from_argument(wire.COMM_DEFAULT_ARGUMENT)


@dataclass(frozen=True)
class FramedRequest:
    """One command, with everything after the separator except the CRC as its argument."""

    name: str
    argument: str


class Overlong(bytes):
    """Prefix of an over-long command line."""


class LineBuffer:
    """Assembles lines from fragments."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._pending = b""
        self._fed_s = 0.0
        self._overlong = False

    def feed(self, data: bytes, now_s: float) -> list[bytes]:
        """Return the lines completed by `data`, without CR and with over-long lines as Overlong."""
        if now_s - self._fed_s > STALE_S:
            self._pending = b""
            self._overlong = False
        self._fed_s = now_s
        lines = (self._pending + data).split(CR)
        self._pending = lines.pop()
        if self._overlong and lines:
            lines[0] = Overlong()
            self._overlong = False
        if len(self._pending) > self._limit:
            self._pending = b""
            self._overlong = True
        return [line if len(line) <= self._limit else Overlong(line[: self._limit]) for line in lines]


def parse_request(line: bytes) -> FramedRequest:
    """Parse one line; raises CommandRefusal if its length or CRC is wrong."""
    if isinstance(line, Overlong):
        raise CommandRefusal(NdiErrorCode.TOO_LONG)
    line = line.lstrip(STRAY_LINE_FEED)
    if not line:
        raise CommandRefusal(NdiErrorCode.TOO_SHORT)
    separator = _SEPARATOR.search(line)
    if separator is None:
        return FramedRequest(line.decode("latin-1"), "")
    name, argument = line[: separator.start()], line[separator.end() :]
    if separator.group() == b":":
        if len(argument) < ASCII_CRC_DIGITS:
            raise CommandRefusal(NdiErrorCode.TOO_SHORT)
        crc = argument[-ASCII_CRC_DIGITS:]
        argument = argument[:-ASCII_CRC_DIGITS]
        sent = line[:-ASCII_CRC_DIGITS]
        if not _FOUR_DIGITS.fullmatch(crc) or int(crc, 16) != crc16(sent):
            raise CommandRefusal(NdiErrorCode.WRONG_CRC)
    return FramedRequest(name.decode("latin-1"), argument.decode("latin-1"))


def ascii_reply(text: str) -> bytes:
    """Frame an ASCII reply: text, four upper-case CRC digits and CR."""
    content = text.encode("latin-1")
    return b"%b%04X\r" % (content, crc16(content))


def binary_reply(body: bytes) -> bytes:
    """Frame a binary reply: start sequence, length, header CRC, body and body CRC, without CR."""
    return _header(len(body)) + body + _U16.pack(crc16(body))


@lru_cache(maxsize=CACHED_HEADERS)
def _header(length: int) -> bytes:
    header = _HEADER.pack(BX_START, length)
    return header + _U16.pack(crc16(header))
