"""The pair that the stereo head took last, drawn for the console in a thread of its own, now and then."""

from __future__ import annotations

import base64
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from procedures.workcell.stereo_look import pair_picture

if TYPE_CHECKING:
    from procedures.workcell.stereo_look import Look

BETWEEN_S = 0.5  # host time from one picture to the next: drawing takes some ten milliseconds
HEIGHT_PX = 240


class LivePictures:
    """`look` takes no time: of what comes while one is drawn only the latest is drawn next."""

    def __init__(self, send: Callable[[str], bool], ending: threading.Event) -> None:
        """`send` takes one line, and returns whether more can be sent; `ending` ends the thread."""
        self._send = send
        self._ending = ending
        self._newest: Look | None = None
        self._arrived = threading.Event()

    def look(self, seen: Look) -> None:
        """Take a look in."""
        self._newest = seen
        self._arrived.set()

    def send_all(self) -> None:
        """Draw and send until `ending`."""
        while not self._ending.wait(BETWEEN_S):
            if not self._arrived.is_set():
                continue
            self._arrived.clear()
            if self._newest is not None and not self._send(picture_line(self._newest)):
                return


def picture_line(seen: Look) -> str:
    """As the console reads it."""
    content = base64.b64encode(pair_picture(seen, HEIGHT_PX)).decode()
    return f'{{"pair":"{content}"}}'
