"""Split the text that clients send into programs, and lines that stand alone."""

from __future__ import annotations

import re
from collections.abc import Iterator

_STRING_OR_COMMENT = re.compile(r'"[^"\n]*"|#.*')
_BLOCK = re.compile(r"\b(def|sec|thread|if|while|for|end)\b")
_BEGINS = re.compile(r"\s*(def|sec)\b")


class ScriptText:
    """Collects the bytes of one client."""

    def __init__(self, longest_bytes: int) -> None:
        self._longest_bytes = longest_bytes
        self._rest = b""
        self._lines: list[str] = []
        self._depth = 0
        self._size = 0

    def feed(self, data: bytes) -> Iterator[str]:
        """Yield what is complete; raises ValueError for a text without end."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if line.strip():
                yield from self._add(line.decode("utf-8", "replace").rstrip("\r"))
        if self._size + len(self._rest) > self._longest_bytes:
            raise ValueError("a script without end")

    def _add(self, line: str) -> Iterator[str]:
        code = _STRING_OR_COMMENT.sub("", line)
        if not self._lines:
            if not code.strip():  # a comment
                return
            if not _BEGINS.match(code):
                yield line.strip()
                return
        self._lines.append(line)
        self._size += len(line) + 1
        for word in _BLOCK.findall(code):
            self._depth += -1 if word == "end" else 1
        if self._depth <= 0:
            text = "\n".join(self._lines)
            self._lines, self._depth, self._size = [], 0, 0
            yield text
