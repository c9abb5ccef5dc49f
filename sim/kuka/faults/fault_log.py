"""Log of injected faults: one line on standard error, with the telegram, when one begins or ends."""

from __future__ import annotations

import sys
from collections.abc import Callable

from sim.world.faults import Fault


class FaultLog:
    """Logs when faults begin and end. `moment` returns theatre time (s) and the telegram's stamp."""

    def __init__(self, moment: Callable[[], tuple[float, int | None]]) -> None:
        self._moment = moment
        self._acting: dict[tuple[int, float | None], Fault] = {}
        self._hits: dict[str, int] = {}

    def look(self, acting: tuple[Fault, ...]) -> None:
        """Log what has begun and ended since the last call."""
        now = {(fault.line, fault.at_s): fault for fault in acting}
        for key, fault in now.items():
            if key not in self._acting:
                self._write(f"{_named(fault)} begins")
        for key, fault in self._acting.items():
            if key not in now:
                hits = self._hits.pop(fault.kind.name, 0)
                self._write(f"{_named(fault)} ends" + (f" after {hits} telegrams" if hits else ""))
        self._acting = now

    def hit(self, kind: str) -> None:
        """Count one telegram or reply affected by a lasting fault."""
        self._hits[kind] = self._hits.get(kind, 0) + 1

    def happened(self, fault: Fault) -> None:
        """Log a momentary fault."""
        self._write(_named(fault))

    def _write(self, what: str) -> None:
        time_s, ipoc = self._moment()
        stamp = f"IPOC {ipoc}" if ipoc is not None else "no RSI"
        sys.stderr.write(f"fault at {time_s:.3f} s, {stamp}: {what}\n")
        sys.stderr.flush()


def _named(fault: Fault) -> str:
    words, arguments = [], iter(fault.arguments)
    for word in fault.kind.phrase.split():
        words.append(next(arguments) if word.isupper() else word)
    return " ".join([fault.kind.device, *words])
