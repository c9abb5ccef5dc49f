"""Frame numbers: 60 counts per second of theatre time, whatever the illuminator rate.

On a clock that follows the host, a request gets the latest frame, or the same one again if it comes too soon.
On a clock that its users advance, each request waits for the next frame, so it gets exactly one; from the
first request to the end of tracking, robot cycles do not pass a frame before it is requested.
"""

from __future__ import annotations

from ronna_hw.clock import SharedClock
from ronna_hw.wire.polaris import FRAME_RATE_HZ

NANOSECONDS_PER_SECOND = 1_000_000_000
COUNTS_PER_SECOND = int(FRAME_RATE_HZ)


class FrameCounter:
    """The frame number, counted from power-up or from the last restart at zero."""

    def __init__(self, clock: SharedClock) -> None:
        self._clock = clock
        self._epoch_ns = clock.now_ns()
        self._begin = 0
        self.last = 0  # frame number of the last request
        self.missed = 0  # measurements skipped by a fault after each one
        self._counts_per_frame = 1

    def start(self, *, restart: bool, rate_hz: int) -> None:
        """Start of tracking; with `restart` the number starts at zero."""
        now_ns = self._clock.now_ns()
        if restart:
            self._epoch_ns = now_ns
        self.missed = 0
        self._counts_per_frame = COUNTS_PER_SECOND // rate_hz
        self._begin = self.last = self._count_at(now_ns)

    def number(self) -> int:
        """The frame number of a request; waits for the next frame if the clock can be advanced."""
        if self._clock.paced:
            self.last = self._measured(self._count_at(self._clock.now_ns()))
            return self.last
        latest = self._measured(max(self.last, self._count_at(self._clock.now_ns())))
        self.last = latest + self._step
        self._clock.wait_until_ns(self._moment_ns(self.last))
        self._clock.expect_reader(self._moment_ns(self.last + self._step))
        return self.last

    def stop(self) -> None:
        """Tracking ends: frames pass unread."""
        self._clock.expect_reader(0)

    def pass_one(self) -> None:
        """A request repeated the last frame; a clock that its users advance moves on anyway."""
        if not self._clock.paced:
            self._clock.wait_until_ns(self._clock.now_ns() + NANOSECONDS_PER_SECOND // COUNTS_PER_SECOND)

    @property
    def repeats(self) -> bool:
        """Whether two requests may get the same frame."""
        return self._clock.paced

    @property
    def last_is_newest(self) -> bool:
        """True while a clock that its users advance has reached no frame after the last one."""
        return not self._clock.paced and self._count_at(self._clock.now_ns()) <= self.last

    def since_start(self, frame: int) -> int:
        """Frames since the start of tracking: the counter of the noise."""
        return frame - self._begin

    def _measured(self, count: int) -> int:
        return count - (count - self._begin) % self._step

    @property
    def _step(self) -> int:
        return self._counts_per_frame * (1 + self.missed)

    def _count_at(self, moment_ns: int) -> int:
        return (moment_ns - self._epoch_ns) * COUNTS_PER_SECOND // NANOSECONDS_PER_SECOND

    def _moment_ns(self, count: int) -> int:
        return self._epoch_ns - (-count * NANOSECONDS_PER_SECOND // COUNTS_PER_SECOND)
