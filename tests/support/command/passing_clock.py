"""A clock of which a test waits nothing: who sleeps finds that the time has passed."""

from __future__ import annotations

from ronna_hw.clock import HostClock


class PassingClock(HostClock):
    """The host's clock, ahead by all that was slept."""

    def __init__(self) -> None:
        super().__init__()
        self._slept_s = 0.0

    def now_s(self) -> float:
        return super().now_s() + self._slept_s

    def sleep(self, duration_s: float) -> None:
        self._slept_s += duration_s
