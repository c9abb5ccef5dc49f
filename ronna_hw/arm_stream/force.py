"""Force on the tool as the real-time process watches it: filtered, tared at rest, compared with a limit."""

from __future__ import annotations

from math import exp, hypot, isfinite

from ronna_hw.arm_stream.records import ForceLimit
from ronna_hw.vectors import Vector3

REST_FILTER_S = 0.1  # of the force at rest, by which an estimate is tared
LEAST_REST_S = 0.5  # at rest, until that force is known to a hundredth
NO_FORCE: Vector3 = (0.0, 0.0, 0.0)


class ForceWatch:
    """Force in the robot base, in N. A value that is no number counts as a force above every limit."""

    def __init__(self, cycle_s: float, filter_s: float, rest_limit_N: float) -> None:
        self._share = 1.0 - exp(-cycle_s / filter_s)
        self._rest_share = 1.0 - exp(-cycle_s / REST_FILTER_S)
        self._least_rest_cycles = round(LEAST_REST_S / cycle_s)
        self._rest_limit_N = rest_limit_N
        self._rest_cycles = 0
        self._at_rest: Vector3 = NO_FORCE
        self._tare: Vector3 | None = None
        self._limit_N = 0.0  # none
        self._is_number = True
        self._motion_peak_N = 0.0  # largest change of the motion under way
        self.filtered_N: Vector3 = NO_FORCE
        self.peak_N = 0.0  # the same since the tare: also before a stop, if the motion goes on after it

    @property
    def change_N(self) -> Vector3:
        """Force that has been added since the tare."""
        (x, y, z), (a, b, c) = self.filtered_N, self._tare or NO_FORCE
        return x - a, y - b, z - c

    @property
    def is_known(self) -> bool:
        """Whether the last value was a number."""
        return self._is_number

    @property
    def is_exceeded(self) -> bool:
        """Whether the motion under way must stop."""
        return self._limit_N > 0.0 and not (self._is_number and self._motion_peak_N <= self._limit_N)

    def begin(self, force: ForceLimit) -> bool:
        """Tare and watch this limit; False if a force acts already, or the force at rest is not known.

        A motion that goes on keeps the tare of the one before, if this process has watched that.
        """
        if self._rest_cycles < self._least_rest_cycles or not self._is_number:
            return False
        if not hypot(*self._at_rest) <= self._rest_limit_N:
            return False
        if not force.goes_on or self._tare is None:
            self._tare, self.peak_N = self._at_rest, 0.0
        self._limit_N, self._motion_peak_N = force.limit_N, 0.0
        return True

    def end(self) -> None:
        """Watch no limit any more."""
        self._limit_N = 0.0

    def note(self, force_N: Vector3, *, moving: bool) -> None:
        """Take the estimate of one cycle."""
        x, y, z = force_N
        self._is_number = isfinite(x + y + z)
        if not self._is_number:
            self._rest_cycles = 0
            return
        a, b, c = self.filtered_N
        share = self._share
        self.filtered_N = (a + share * (x - a), b + share * (y - b), c + share * (z - c))
        if moving:
            self._rest_cycles = 0
        elif self._rest_cycles:
            a, b, c = self._at_rest
            share = self._rest_share
            self._at_rest = (a + share * (x - a), b + share * (y - b), c + share * (z - c))
            self._rest_cycles += 1
        else:
            self._at_rest, self._rest_cycles = self.filtered_N, 1
        if self._limit_N:
            change_N = hypot(*self.change_N)
            self._motion_peak_N = max(self._motion_peak_N, change_N)
            self.peak_N = max(self.peak_N, change_N)
