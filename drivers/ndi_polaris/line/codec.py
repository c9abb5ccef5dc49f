"""Framing of the Polaris link: commands out, ASCII and binary replies in, every CRC checked.

Pure functions on bytes. The content is decoded elsewhere, such as in `tracking/tx_reply.py`.
"""

from __future__ import annotations

import re
import struct
from functools import lru_cache

from drivers.ndi_polaris.errors import BadReplyCrc, MalformedReply, UnitError, error_for
from ronna_hw.wire.polaris import (
    ASCII_CRC_DIGITS,
    BX_CRC_BYTES,
    BX_HEADER_BYTES,
    BX_START,
    CR,
    REPLY_WARNING,
    WARNING_MEANINGS,
    crc16,
)

KEPT_COMMANDS = 32  # every reading sends the same command
TRAILING_TEXT_BYTES = 128  # short texts only: errors, echoes, revisions
BX_START_BYTES = struct.pack("<H", BX_START)

_HEADER = struct.Struct("<HHH")
_CRC = struct.Struct("<H")
_ERROR = re.compile(r"ERROR([0-9A-F]{2})")
_WARNING = re.compile(rf"{REPLY_WARNING}([0-9A-F]{{2}})?")


@lru_cache(maxsize=KEPT_COMMANDS)
def encode_command(name: str, argument: str = "") -> bytes:
    """`NAME:argument` + CRC + CR: the form whose CRC the unit checks."""
    text = f"{name}:{argument}".encode("ascii")
    return b"%b%04X\r" % (text, crc16(text))


def open_ascii(line: bytes) -> str:
    """The text of one ASCII reply (without its CR); raises NDI-005."""
    text = line[:-ASCII_CRC_DIGITS]
    if not _crc_is_right(line):
        raise BadReplyCrc("wrong CRC in an ASCII reply", expected=f"{crc16(text):04X}", wire=line)
    try:
        return text.decode("ascii")
    except UnicodeDecodeError as error:
        raise MalformedReply("an ASCII reply contains bytes that are not ASCII", wire=line) from error


def trailing_text(heard: bytes) -> str | None:
    """The text of the last reply (without its CR) in bytes that may begin with remnants of others."""
    line = heard.rsplit(CR, 1)[-1][-TRAILING_TEXT_BYTES:]
    # A preceding binary reply does not end in CR; the CRC over a complete one is 0, so the text would be
    # valid together with it.
    for start in range(len(line)):
        if line[start:].isascii() and _crc_is_right(line[start:]):
            return line[start:-ASCII_CRC_DIGITS].decode("ascii")
    return None


def _crc_is_right(line: bytes) -> bool:
    # an empty text is legal: an empty parameter list has CRC 0000
    text, digits = line[:-ASCII_CRC_DIGITS], line[-ASCII_CRC_DIGITS:]
    return len(digits) == ASCII_CRC_DIGITS and digits == b"%04X" % crc16(text)


def ascii_line(buffer: bytes) -> tuple[bytes, bytes] | None:
    """Split off the first reply that ends in CR: (line without CR, rest), or None while incomplete."""
    line, end, rest = buffer.partition(CR)
    return (line, rest) if end else None


def binary_reply_bytes(header: bytes) -> int:
    """Length of a complete binary reply from its first six bytes; raises NDI-005 or NDI-006."""
    start, length, crc = _HEADER.unpack_from(header)
    if start != BX_START:
        raise MalformedReply("a binary reply does not start with C4 A5", wire=header)
    if crc != crc16(header[: BX_HEADER_BYTES - BX_CRC_BYTES]):
        raise BadReplyCrc("wrong CRC in the header of a binary reply", wire=header[:BX_HEADER_BYTES])
    return BX_HEADER_BYTES + int(length) + BX_CRC_BYTES


def split_binary(buffer: bytes) -> tuple[bytes, bytes] | None:
    """Split off the first binary reply: (its body, rest), or None while incomplete.

    Raises NDI-005 for a wrong CRC of header or body, NDI-006 for a wrong start sequence.
    """
    if len(buffer) < BX_HEADER_BYTES:
        return None
    whole = binary_reply_bytes(buffer)
    if len(buffer) < whole:
        return None
    body = buffer[BX_HEADER_BYTES : whole - BX_CRC_BYTES]
    (crc,) = _CRC.unpack_from(buffer, whole - BX_CRC_BYTES)
    if crc != crc16(body):
        raise BadReplyCrc(
            "wrong CRC in the body of a binary reply", expected=f"{crc16(body):04X}", wire=buffer[:whole]
        )
    return body, buffer[whole:]


def unit_error(text: str, command: str = "") -> UnitError | None:
    """The typed error if the reply is ERRORhh, else None."""
    match = _ERROR.fullmatch(text)
    return error_for(int(match[1], 16), command) if match else None


def warning_meaning(text: str) -> str | None:
    """The meaning of a WARNING reply, else None. The command was executed nevertheless."""
    match = _WARNING.fullmatch(text)
    if not match:
        return None
    if match[1] is None:
        return "a warning without a code (older firmware)"
    return WARNING_MEANINGS.get(int(match[1], 16), f"undocumented warning {match[1]}")
