"""Splits a byte stream into telegrams: EKI has no framing, a telegram ends with its root element.

A truncated telegram is detected by the first bytes of the next one. Otherwise the next would count as part of
it, and the controller would go unheard until the longest telegram is full.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NoReturn
from xml.etree import ElementTree

from drivers.kuka_rsi.errors import BadEkiTelegram
from ronna_hw.bounded_input import InputRefused, parse_xml
from ronna_hw.wire.kuka_eki import ACK, STATE

LONGEST_TELEGRAM = 16384  # the default BUFFSIZE of an EKI channel
ROOTS = (STATE.encode(), ACK.encode())  # root tags with which a controller begins a telegram

_MARK = re.compile(rb"[<>\"']")
_NAME = re.compile(rb"[^\s/>]*")


class TelegramScanner:
    """Feed it received bytes; it yields the complete root elements.

    Padding and anything else before a root is skipped. A document type declaration is refused.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._begin = -1  # of the root, -1 between telegrams
        self._place = 0  # scanned so far
        self._depth = 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Complete telegrams, in order. Raises EKI-004 if one is truncated, grows too long or is not XML."""
        self._buffer += data
        while (tag := self._next_tag()) is not None:
            start, end = tag
            inner = bytes(self._buffer[start + 1 : end])
            if inner[:1] == b"!":
                raise BadEkiTelegram("an XML declaration inside a telegram", wire=bytes(self._buffer))
            if inner[:1] == b"?":
                continue
            if self._begin < 0:
                if inner[:1] == b"/":
                    continue  # the end of something whose beginning was lost
                self._begin, self._depth = start, 0
            elif _name(inner) in ROOTS:
                self._break_off()
            if inner[:1] == b"/":
                self._depth -= 1
            elif inner[-1:] != b"/":
                self._depth += 1
            if self._depth == 0:
                yield bytes(self._buffer[self._begin : end + 1])
                del self._buffer[: end + 1]
                self._begin, self._place = -1, 0
        if len(self._buffer) > LONGEST_TELEGRAM:
            raise BadEkiTelegram(
                "a telegram without end tag", limit=f"{LONGEST_TELEGRAM} bytes", wire=bytes(self._buffer)
            )

    def _next_tag(self) -> tuple[int, int] | None:
        """Positions of the next "<" and its ">", respecting quotes; None until both have arrived."""
        buffer = self._buffer
        start = buffer.find(b"<", self._place)
        if start < 0:
            if self._begin < 0:
                buffer.clear()
            self._place = len(buffer)
            return None
        if self._begin < 0 and start > 0:
            del buffer[:start]
            start = 0
        quote = b""
        for mark in _MARK.finditer(buffer, start + 1):
            found = mark[0]
            if found == b"<":
                self._break_off()  # no tag contains one, not even in quotes
            if quote:
                quote = b"" if found == quote else quote
            elif found != b">":
                quote = found
            else:
                self._place = mark.end()
                return start, mark.start()
        self._place = start
        return None

    def _break_off(self) -> NoReturn:
        raise BadEkiTelegram("a telegram is truncated", expected="its end", wire=bytes(self._buffer))


def _name(tag: bytes) -> bytes:
    """Name of an opening tag; empty for a closing one."""
    found = _NAME.match(tag)
    return found[0] if found else b""


def parse_telegram(telegram: bytes) -> ElementTree.Element:
    """The root element; raises EKI-004 when the bytes are not well-formed."""
    try:
        return parse_xml(telegram, LONGEST_TELEGRAM)
    except InputRefused as error:
        raise BadEkiTelegram(f"not a well-formed telegram: {error.summary}", wire=telegram) from error
