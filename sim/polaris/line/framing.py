"""Framing: bytes to requests, replies to bytes.

A request is `NAME:args` + CRC, `NAME args`, or the bare name; all end in CR.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

from ronna_hw.wire.polaris import ASCII_CRC_DIGITS, BX_START, CR, crc16
from sim.polaris.unit.refusal import ErrorCode, Refusal

STALE_S = 1.0  # half a command this old was left by a client that disappeared
STRAY_LINE_FEED = b"\n"  # from clients that end a line with CR LF

_form = re.compile(rb"[: ]")
_hexadecimal = re.compile(rb"[0-9A-Fa-f]{4}")
_u16 = struct.Struct("<H")
_header = struct.Struct("<HH")


@dataclass(frozen=True)
class Request:
    """One command; its argument is everything after the separator, without the CRC."""

    name: str
    argument: str


class Overlong(bytes):
    """The start of a line that is longer than any command."""


class LineBuffer:
    """Assembles lines from bytes, however fragmented."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._pending = b""
        self._fed_s = 0.0
        self._overlong = False

    def feed(self, data: bytes, now_s: float) -> list[bytes]:
        """The lines that `data` completes, without their CR; a line over the limit becomes Overlong."""
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


def parse_request(line: bytes) -> Request:
    """Read one line; raises Refusal for a line that is too long, too short, or has a wrong CRC."""
    if isinstance(line, Overlong):
        raise Refusal(ErrorCode.TOO_LONG)
    line = line.lstrip(STRAY_LINE_FEED)
    if not line:
        raise Refusal(ErrorCode.TOO_SHORT)
    separator = _form.search(line)
    if separator is None:
        return Request(line.decode("latin-1"), "")
    name, argument = line[: separator.start()], line[separator.end() :]
    if separator.group() == b":":
        if len(argument) < ASCII_CRC_DIGITS:
            raise Refusal(ErrorCode.TOO_SHORT)
        crc = argument[-ASCII_CRC_DIGITS:]
        argument = argument[:-ASCII_CRC_DIGITS]
        sent = line[:-ASCII_CRC_DIGITS]
        if not _hexadecimal.fullmatch(crc) or int(crc, 16) != crc16(sent):
            raise Refusal(ErrorCode.WRONG_CRC)
    return Request(name.decode("latin-1"), argument.decode("latin-1"))


def ascii_reply(text: str) -> bytes:
    """An ASCII reply: text, CRC in four upper-case digits, CR."""
    content = text.encode("latin-1")
    return b"%b%04X\r" % (content, crc16(content))


def binary_reply(body: bytes) -> bytes:
    """A binary reply: start sequence, length, header CRC, body, body CRC, nothing after it."""
    header = _header.pack(BX_START, len(body))
    return header + _u16.pack(crc16(header)) + body + _u16.pack(crc16(body))
