"""The host's end of a pseudo-terminal as reported by Linux: line settings, flushes, open and close."""

from __future__ import annotations

import ctypes
import fcntl
import os
import struct
import termios

from sim.polaris.line.line_settings import LineSettings

# <asm-generic/ioctls.h> and <asm-generic/termbits.h>: settings with rates as plain numbers.
TCGETS2 = 0x802C542A
_termios2 = struct.Struct("<4IB19s2I")  # four flag words, line discipline, control characters, rates
CONTROL_FLAGS, INPUT_BAUD, OUTPUT_BAUD = 2, 6, 7
# <sys/inotify.h>
IN_CLOSE_WRITE, IN_CLOSE_NOWRITE, IN_OPEN = 0x8, 0x10, 0x20
_event = struct.Struct("<iIII")  # watch, event mask, cookie, length of the name that follows
EVENTS_BYTES = 4096


def packet_mode(master: int) -> None:
    """Prefix every read with a control byte: 0 for data, otherwise what was flushed or stopped."""
    fcntl.ioctl(master, termios.TIOCPKT, struct.pack("i", 1))


class HostLine:
    """The line settings of the host's end, as far as a pseudo-terminal keeps them."""

    def __init__(self, master: int) -> None:
        self._master = master
        self._judged: tuple[bytes, LineSettings] | None = None
        self._agreed = False

    def agrees(self, line: LineSettings) -> bool:
        """False only if host and unit certainly cannot understand each other."""
        content = fcntl.ioctl(self._master, TCGETS2, bytes(_termios2.size))
        if self._judged is None or self._judged[1] is not line or self._judged[0] != content:
            self._judged = (content, line)
            fields = _termios2.unpack(content)
            same_rate = fields[INPUT_BAUD] == fields[OUTPUT_BAUD] == line.baud
            odd_enough = line.parity != "odd" or bool(fields[CONTROL_FLAGS] & termios.PARODD)
            self._agreed = same_rate and odd_enough
        return self._agreed


class HostSideWatch:
    """Counts opens of the host's end with inotify; the unit's own descriptor does not count."""

    def __init__(self, path: str) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        self.file = library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        events = IN_OPEN | IN_CLOSE_WRITE | IN_CLOSE_NOWRITE
        if self.file < 0 or library.inotify_add_watch(self.file, path.encode(), events) < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), path)
        self._holders = 0

    def events(self) -> tuple[bool, bool]:
        """(opened, last host left) since the previous call."""
        try:
            content = os.read(self.file, EVENTS_BYTES)
        except BlockingIOError:
            return False, False
        opened = left = False
        offset = 0
        while offset < len(content):
            _, what, _, name_length = _event.unpack_from(content, offset)
            offset += _event.size + name_length
            if what & IN_OPEN:
                self._holders += 1
                opened = True
            elif what & (IN_CLOSE_WRITE | IN_CLOSE_NOWRITE):
                self._holders = max(0, self._holders - 1)
                left = left or self._holders == 0
        return opened, left

    def close(self) -> None:
        """Stop watching."""
        os.close(self.file)
