"""Messages of the teach pendant, printed on standard error by number, and EStr texts."""

from __future__ import annotations

import sys
from collections.abc import Callable

from sim.kuka.controller.messages import Message

LINE_BEGINS = "pendant at "  # beginning of each of its lines


class MessageDisplay:
    """Call `look` whenever something may have changed; `now_s` returns theatre time."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._message: Message | None = None
        self._notice = ""

    def look(self, message: Message | None, notice: str) -> None:
        """Print a new message or text, and the acknowledgement of a message."""
        if message is not self._message:
            shown, self._message = self._message, message
            if message is not None:
                self._write(f"{_number(message)} {message.text}")
            elif shown is not None:
                self._write(f"{_number(shown)} acknowledged")
        if notice != self._notice:
            self._notice = notice
            if notice:
                self._write(notice)

    def _write(self, what: str) -> None:
        text = "".join(letter if letter.isprintable() else " " for letter in what)
        sys.stderr.write(f"{LINE_BEGINS}{self._now_s():.3f} s: {text}\n")
        sys.stderr.flush()


def _number(message: Message) -> str:
    return f"KSS{message.number:05d}"
