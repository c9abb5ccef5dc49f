"""Finds whole telegrams in a stream of bytes: EKI has no framing, a telegram ends with its root element."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree

from drivers.kuka_rsi.errors import BadEkiTelegram

LONGEST_TELEGRAM = 16384  # the default BUFFSIZE of an EKI channel


class TelegramScanner:
    """Feed it what was received; it gives the root elements that are complete.

    Padding and anything else before a root is skipped. A declaration of a document type is refused.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._begin = -1  # of the root, -1 while between telegrams
        self._place = 0  # scanned so far
        self._depth = 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Whole telegrams, in order. Raises EKI-004 when one grows too long or is not XML."""
        self._buffer += data
        while (tag := self._next_tag()) is not None:
            start, end = tag
            inner = bytes(self._buffer[start + 1 : end])
            if inner[:1] == b"!":
                raise BadEkiTelegram("a declaration in a telegram", wire=bytes(self._buffer))
            if inner[:1] == b"?":
                continue
            if self._begin < 0:
                if inner[:1] == b"/":
                    continue  # the end of something whose beginning was lost
                self._begin, self._depth = start, 0
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
                "a telegram does not end", limit=f"{LONGEST_TELEGRAM} bytes", wire=bytes(self._buffer)
            )

    def _next_tag(self) -> tuple[int, int] | None:
        """Positions of the next "<" and its ">", quotes respected; None until both are there."""
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
        quote = 0
        for k in range(start + 1, len(buffer)):
            byte = buffer[k]
            if quote:
                quote = 0 if byte == quote else quote
            elif byte in b"\"'":
                quote = byte
            elif byte == ord(">"):
                self._place = k + 1
                return start, k
        self._place = start
        return None


def parse_telegram(telegram: bytes) -> ElementTree.Element:
    """The root element; raises EKI-004 when the bytes are not well formed."""
    try:
        return ElementTree.fromstring(telegram)
    except ElementTree.ParseError as error:
        raise BadEkiTelegram(f"not a well-formed telegram: {error}", wire=telegram) from error
