"""Trapezoidal speed profile of a motion of either make of arm."""

from __future__ import annotations

from math import sqrt


class Trapezoid:
    """Path over time in s; length, speed and acceleration are in any unit of length."""

    def __init__(self, length: float, speed: float, acceleration: float) -> None:
        self._length, self._acceleration = length, acceleration
        self._speed = min(speed, sqrt(length * acceleration))  # the path may be too short to reach it
        self._ramp_s = self._speed / acceleration
        self.duration_s = 2.0 * self._ramp_s + (length / self._speed - self._ramp_s)

    def share(self, time_s: float) -> float:
        """Return the fraction of the path that is behind after that time."""
        remaining_s = self.duration_s - time_s
        if remaining_s <= 0.0:
            return 1.0
        if time_s < self._ramp_s:
            return self._acceleration * time_s**2 / 2.0 / self._length
        if remaining_s > self._ramp_s:
            return self._speed * (time_s - self._ramp_s / 2.0) / self._length
        return 1.0 - self._acceleration * remaining_s**2 / 2.0 / self._length
