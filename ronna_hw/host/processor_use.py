"""How long a process has used no processor time: even on a busy computer one that works uses some."""

from __future__ import annotations

import contextlib
import time

LOOK_S = 1.0  # between two readings, each of which lists the computer's processes


class ProcessorUse:
    """Processor time of one process and its descendants, observed from now on."""

    def __init__(self, number: int) -> None:
        """`number` of the process."""
        self._number = number
        self._used_s = 0.0
        self._changed_s = self._next_s = time.monotonic()

    def idle_s(self) -> float:
        """Host time since the process, or a descendant, was last seen to have used processor time."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + LOOK_S
            used_s = _used_s(self._number)
            if used_s != self._used_s:
                self._used_s, self._changed_s = used_s, now_s
        return now_s - self._changed_s


def _used_s(number: int) -> float:
    import psutil  # imported late: device processes import little

    used_s = 0.0
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(number)
        for one in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                used_s += sum(one.cpu_times())
    return used_s
