"""Log of the faults that a device process has had, on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable

from sim.world.faults.fault import Fault


class FaultLog:
    """Logs the start and end of faults on standard error, stamped with time and cycle from `moment`."""

    def __init__(self, moment: Callable[[], tuple[float, str]]) -> None:
        self._moment = moment
        self._acting: dict[tuple[int, float | None], Fault] = {}
        self._hits: dict[str, int] = {}

    def update(self, acting: tuple[Fault, ...]) -> None:
        """Log the faults that have begun or ended since the last call."""
        now = {(fault.line, fault.at_s): fault for fault in acting}
        for key, fault in now.items():
            if key not in self._acting:
                self._write(f"{fault.device_phrase} begins")
        for key, fault in self._acting.items():
            if key not in now:
                hits = self._hits.pop(fault.kind.name, 0)
                self._write(f"{fault.device_phrase} ends" + (f" after {hits} telegrams" if hits else ""))
        self._acting = now

    def hit(self, kind: str) -> None:
        """Count a telegram affected by a lasting fault."""
        self._hits[kind] = self._hits.get(kind, 0) + 1

    def happened(self, fault: Fault) -> None:
        """Log a momentary fault."""
        self._write(fault.device_phrase)

    def _write(self, what: str) -> None:
        time_s, cycle = self._moment()
        sys.stderr.write(f"fault at {time_s:.3f} s, {cycle}: {what}\n")
        sys.stderr.flush()
