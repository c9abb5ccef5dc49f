"""Whether two images come from the same trigger, judged by the cameras' own clocks. No I/O, no clock access.

Each camera counts ticks from its own zero. Latching the counter at the start of the stream ties it to theatre
time; every correctly paired image renews the tie, so that clock drift does not accumulate.
"""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.devices.readings import Validity

DRIFT = 2e-4  # of one camera's clock relative to another: 100 ppm each


@dataclass(frozen=True)
class Tie:
    """A camera's tick count at a theatre time, known to within `uncertainty_s`."""

    ticks: int
    frequency_hz: int
    theatre_s: float
    uncertainty_s: float

    def moment_s(self, ticks: int) -> float:
        """Theatre time of a tick count."""
        return self.theatre_s + (ticks - self.ticks) / self.frequency_hz

    def error_s(self, now_s: float) -> float:
        """Bound on the present error of `moment_s`."""
        return self.uncertainty_s + DRIFT * max(0.0, now_s - self.theatre_s)


class PairClock:
    """Judges the pairs of one stream. `skew_s`: largest difference between one trigger's exposure starts."""

    def __init__(self, ties: tuple[Tie | None, Tie | None], skew_s: float) -> None:
        self._ties = ties
        self._skew_s = skew_s

    @property
    def tied(self) -> bool:
        """Whether the counts of both cameras are tied to theatre time."""
        return None not in self._ties

    def moments_s(self, ticks: tuple[int, int]) -> tuple[float | None, float | None]:
        """Theatre time at which each exposure began, if known."""
        left, right = (
            tie.moment_s(count) if tie else None for tie, count in zip(self._ties, ticks, strict=True)
        )
        return left, right

    def judge(self, ticks: tuple[int, int], triggered_s: float, now_s: float) -> Validity:
        """UNPAIRED if left and right come from different triggers; STALE if both are older; else OK.

        `triggered_s` and `now_s` are theatre times before the trigger and after both images arrived. Without
        ties the first pair cannot be judged.
        """
        left, right = self.moments_s(ticks)
        error_s = sum(tie.error_s(now_s) for tie in self._ties if tie)
        if left is not None and right is not None:
            if abs(left - right) > self._skew_s + error_s:
                return Validity.UNPAIRED
            if max(left, right) < triggered_s - self._skew_s - error_s:
                return Validity.STALE
        return Validity.OK

    def confirm(
        self, ticks: tuple[int, int], frequencies_hz: tuple[int, int], triggered_s: float, now_s: float
    ) -> None:
        """The pair is valid: tie both clocks to a time between its trigger and now."""
        known = [moment_s for moment_s in self.moments_s(ticks) if moment_s is not None]
        moment_s = min(max(triggered_s, sum(known) / len(known) if known else triggered_s), now_s)
        left, right = (
            Tie(count, frequency, moment_s, tie.uncertainty_s if tie else self._skew_s) if frequency else None
            for count, frequency, tie in zip(ticks, frequencies_hz, self._ties, strict=True)
        )
        self._ties = (left, right)
