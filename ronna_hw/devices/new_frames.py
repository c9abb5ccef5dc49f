"""Iterates over a tracker's measurements."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

from ronna_hw.devices.errors import NoNewFrame
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.devices.tracker import OpticalTracker

ASK_AGAIN_S = 0.005  # host time; a tracker measures every 16 ms


def new_frames(
    tracker: OpticalTracker, count: int | None = None, *, timeout_s: float = 1.0
) -> Iterator[TrackerFrame]:
    """Yield `count` measurements, or endless ones; each is new, none is STALE.

    `timeout_s`: host time for each. Raises DEV-009 when the tracker delivers no new measurement in time, and
    the errors of `read_frame`.
    """
    for _ in itertools.count() if count is None else range(count):
        yield _new_frame(tracker, timeout_s)


def _new_frame(tracker: OpticalTracker, timeout_s: float) -> TrackerFrame:
    deadline_s = time.monotonic() + timeout_s
    while (left_s := deadline_s - time.monotonic()) > 0:
        frame = tracker.read_frame(left_s)
        if frame.validity is not Validity.STALE:
            return frame
        time.sleep(ASK_AGAIN_S)
    raise NoNewFrame(f"{tracker.name} delivers no new measurement", limit=f"{timeout_s:g} s")
