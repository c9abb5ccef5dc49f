"""Timing of a frame: exposure, read-out, transfer, and the time of its trigger."""

from __future__ import annotations

import threading
import time
from typing import Protocol

from ronna_hw.wire.gige_vision import SENSOR_HEIGHT_PX, TICK_FREQUENCY_HZ
from sim.basler.camera.settings import FrameSettings, Settings
from sim.basler.faults import NO_FAULTS, CameraFaults

FULL_FRAME_RATE_HZ = 50.0
ROW_US = 1e6 / FULL_FRAME_RATE_HZ / SENSOR_HEIGHT_PX  # read-out of one row
LINK_BYTES_PER_S = 115e6  # image data on 1 Gbit/s: 50 frames/s of 8 bits, 26 of 12, 34 of 12 packed
NS_PER_TICK = 1_000_000_000 // TICK_FREQUENCY_HZ
# In lock-step two triggers within this host time belong together, and the theatre time between them is at
# most that between two software triggers on a real network.
SAME_PAIR_HOST_NS = 500_000_000
SOFTWARE_TRIGGER_SKEW_NS = 1_000_000


class TheatreClock(Protocol):
    """What the cameras need from the theatre clock."""

    @property
    def paced(self) -> bool: ...

    def now_ns(self) -> int: ...

    def wait_until_ns(self, moment_ns: int) -> None: ...


def readout_us(frame: FrameSettings) -> float:
    """Time from the end of exposure until the image has left the sensor."""
    return frame.area.height * ROW_US


def shortest_period_us(frame: FrameSettings) -> float:
    """Shortest time between two frames: exposure, read-out and transfer overlap, the slowest decides."""
    return max(float(frame.exposure_us), readout_us(frame), frame.payload_bytes / LINK_BYTES_PER_S * 1e6)


def free_running_period_us(settings: Settings) -> float:
    """Time between two frames without a frame trigger."""
    shortest = max(shortest_period_us(settings.frame()), 1e6 / FULL_FRAME_RATE_HZ)
    return max(shortest, 1e6 / settings.frame_rate_hz) if settings.frame_rate_enabled else shortest


class TriggerMoments:
    """Theatre time of a trigger, for both cameras of the pair.

    In real time a trigger acts when it arrives. In lock-step the first camera's frame may already have
    advanced the theatre when the second trigger comes: the second is then backdated to the first, so that a
    pair triggered sequentially stays a pair and does not take twice the time.
    """

    def __init__(self, clock: TheatreClock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._alone: tuple[str, int, int] | None = None  # camera, host time, theatre time of a first half

    def of(self, camera: str) -> int:
        """Theatre time in ns of a trigger that this camera is receiving now."""
        now = self._clock.now_ns()
        if self._clock.paced:
            return now
        host = time.monotonic_ns()
        with self._lock:
            first = self._alone
            if first is None or first[0] == camera or host - first[1] > SAME_PAIR_HOST_NS:
                self._alone = (camera, host, now)
                return now
            self._alone = None
            return min(now, first[2] + SOFTWARE_TRIGGER_SKEW_NS)


class Ticks:
    """The camera's time stamp counter, driven by the theatre clock."""

    def __init__(self, clock: TheatreClock, faults: CameraFaults = NO_FAULTS) -> None:
        self._clock = clock
        self._faults = faults
        self._zero_ns = 0
        self._last_stamp = 0
        self._gained_ns = 0.0  # by drift
        self._drifted_until_ns = 0
        self.latched = 0

    def stamp(self, moment_ns: int) -> int:
        """Ticks at a theatre time; never repeats, even for frames at the same theatre time."""
        self._last_stamp = max(self._at(moment_ns), self._last_stamp + 1)
        return self._last_stamp

    def count(self, moment_ns: int) -> int:
        """Ticks at a theatre time, for anything but frames."""
        return self._at(moment_ns)

    def latch(self) -> None:
        """Latch the present value for reading."""
        self.latched = self._at(self._clock.now_ns())

    def reset(self) -> None:
        """Restart from zero."""
        self._zero_ns = self._clock.now_ns()
        self._last_stamp = 0

    def _at(self, moment_ns: int) -> int:
        if self._faults.happened("reset_clock"):
            self.reset()
        drift_ppm = self._faults.drift_ppm()
        if drift_ppm:
            self._gained_ns += max(0, moment_ns - self._drifted_until_ns) * drift_ppm * 1e-6
        self._drifted_until_ns = moment_ns
        return max(0, moment_ns - self._zero_ns + round(self._gained_ns)) // NS_PER_TICK
