"""Lost cycles of a stream: slow down after a few, stop when most are lost."""

from __future__ import annotations

DEGRADED_SPEED = 0.5  # share of the planned speed while degraded
# Safety against a link that loses telegrams (U).
DEGRADED_ABOVE = 3  # lost cycles in one stretch

STRETCH_CYCLES = 250  # loss-free cycles after which the count of the stretch restarts (1 s at 4 ms)
WINDOW_CYCLES = 250  # over which the share of lost cycles is judged
# Safety against a link that loses telegrams (U).
UNUSABLE_SHARE = 0.35  # in two consecutive windows: far above 20 %, which is tolerated

UNUSABLE_WINDOWS = 2  # one stall of the host, or one burst, does not fill two
RECOVERED_CYCLES = 1000  # loss-free cycles after which full working speed is allowed again


class LossCount:
    """Counters of lost telegrams and replies; the arm slows down while `degraded`.

    `lost`: telegrams that never arrived. `late`: cycles without an effective reply of ours. The cycles of a
    gap are among them, as they were not answered: only a count beyond the gap means that our last reply was
    not accepted.
    """

    def __init__(self) -> None:
        self._stretch = 0
        self._clean = 0
        self._window = (0, 0)  # cycles and losses of the present one
        self._bad_windows = 0  # consecutive
        self.lost = 0
        self.late = 0
        self.degraded = False
        self.reply_lost = False  # the last reply had no effect
        self.held_cycles = 0  # consecutive cycles, up to now, without an effective reply

    def note(self, missing: int, late: int, *, standing: bool = False) -> None:
        """Count one telegram, the `missing` ones before it, and the late replies that it reports.

        Replies to a controller that is `standing` by its own setting have no effect, and are not lost.
        """
        self.reply_lost = late > missing
        self.held_cycles = missing + self.held_cycles + 1 if self.reply_lost else missing
        late = missing if standing else late
        self.lost += missing
        self.late += late
        self._judge_stretch(max(missing, late))
        self._judge_window(1 + missing, max(missing, late))

    @property
    def is_unusable(self) -> bool:
        """Whether losses have been too high for too long to continue any motion."""
        return self._bad_windows >= UNUSABLE_WINDOWS

    def _judge_window(self, cycles: int, losses: int) -> None:
        seen, lost = self._window[0] + cycles, self._window[1] + losses
        if seen < WINDOW_CYCLES:
            self._window = (seen, lost)
            return
        self._bad_windows = self._bad_windows + 1 if lost > UNUSABLE_SHARE * seen else 0
        self._window = (0, 0)

    def _judge_stretch(self, losses: int) -> None:
        if losses:
            self._stretch += losses
            self._clean = 0
            self.degraded |= self._stretch > DEGRADED_ABOVE
            return
        self._clean += 1
        if self._clean >= STRETCH_CYCLES:
            self._stretch = 0
        if self._clean >= RECOVERED_CYCLES:
            self.degraded = False
