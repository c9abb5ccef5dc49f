"""Acquisition control: start and stop, triggered or free-running, within the camera's frame rate."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from ronna_hw.clock import SharedClock
from sim.basler.camera.photographer import Photographer
from sim.basler.faults import NO_FAULTS, CameraFaults
from sim.basler.settings import (
    AcquisitionMode,
    CameraSettings,
    EventKind,
    FrameSettings,
    Ticks,
    Trigger,
    TriggerMoments,
    TriggerSettings,
    TriggerSource,
    free_running_period_us,
    readout_us,
    shortest_period_us,
)
from sim.basler.stream_channel import SentImage, StreamChannel

IDLE_CHECK_S = 0.5
FRAMES_IN_PROGRESS = 2  # one being drawn or sent, one being exposed
FRAMES_LATE = 3  # how far a free run may lag before it drops frames


@dataclass(frozen=True)
class _Exposure:
    """A scheduled exposure, numbered within its acquisition."""

    acquisition: int
    number: int
    start_ns: int
    frame: FrameSettings


class Acquisition:
    """Takes frames on its own thread and passes them to the stream channel.

    `moments` is shared by the cameras of a pair; `report` is called for every event: kind, block id (0
    without a frame), theatre time in ns. `is_line_lit` tells at a frame's start whether the line laser lights
    its exposure. All public methods may be called from any thread.
    """

    def __init__(
        self,
        name: str,
        settings: Callable[[], CameraSettings],
        source: Photographer,
        channel: StreamChannel,
        clock: SharedClock,
        ticks: Ticks,
        moments: TriggerMoments,
        report: Callable[[EventKind, int, int], None],
        faults: CameraFaults = NO_FAULTS,
        is_line_lit: Callable[[], bool] = lambda: False,
    ) -> None:
        self._name = name
        self._settings = settings
        self._source = source
        self._channel = channel
        self._clock = clock
        self._ticks = ticks
        self._moments = moments
        self._report = report
        self._faults = faults
        self._is_line_lit = is_line_lit
        self._changed = threading.Condition()
        self._waiting: deque[_Exposure] = deque()
        self._acquisition = 0
        self._running = False
        self._closed = False
        self._triggers = TriggerCounter()
        self._free_frames = 0
        self._permitted: int | None = None  # frames until the next AcquisitionStart trigger; None: no limit
        self._ready_ns = 0
        self._free_due_ns = 0
        self._missed_triggers = 0
        self._exposed_ns = (0, 0)  # begin and end of the last exposure
        self._thread = threading.Thread(target=self._work, name=f"{name} acquisition", daemon=True)

    def open(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop the thread once the current frame is complete."""
        with self._changed:
            self._running, self._closed = False, True
            self._changed.notify_all()

    @property
    def running(self) -> bool:
        """Whether an acquisition is active, from AcquisitionStart to its end."""
        return self._running

    @property
    def missed_triggers(self) -> int:
        """Number of frame triggers lost since AcquisitionStart because the camera was busy."""
        return self._missed_triggers

    @property
    def awaits_trigger(self) -> bool:
        """Whether a frame trigger would be accepted now."""
        with self._changed:
            return (
                self._running
                and bool(self._settings().triggers[Trigger.FRAME_START].mode)
                and self._permitted != 0
                and not self._is_busy()
            )

    @property
    def awaits_permission(self) -> bool:
        """Whether an AcquisitionStart trigger would be accepted now."""
        return self._running and self._permitted == 0

    @property
    def is_exposing(self) -> bool:
        """Whether a frame is being exposed now."""
        begin_ns, end_ns = self._exposed_ns
        return begin_ns <= self._clock.now_ns() < end_ns

    def start(self) -> None:
        """Execute AcquisitionStart; no effect while running."""
        with self._changed:
            if self._running or self._closed:
                return
            settings = self._settings()
            self._acquisition += 1
            self._running = True
            self._triggers.start()
            self._free_frames = self._missed_triggers = 0
            self._ready_ns = self._free_due_ns = 0
            self._permitted = 0 if settings.triggers[Trigger.ACQUISITION_START].mode else None
            self._waiting.clear()
            self._channel.begin()
            self._changed.notify_all()

    def stop(self) -> None:
        """Execute AcquisitionStop: finish the frame being sent, then send no more."""
        with self._changed:
            self._running = False
            self._acquisition += 1
            self._waiting.clear()

    def software_trigger(self) -> None:
        """Execute TriggerSoftware: fire the selected trigger if its source is software."""
        selected = Trigger(self._settings().trigger_selector)
        self._fire(selected, TriggerSource.SOFTWARE)

    def action(self) -> None:
        """Fire the triggers whose source is the action command."""
        for trigger in Trigger:
            self._fire(trigger, TriggerSource.ACTION_1)

    def line(self) -> None:
        """Fire the triggers whose source is the trigger line."""
        for trigger in Trigger:
            self._fire(trigger, TriggerSource.LINE_1)

    def _fire(self, which: Trigger, source: TriggerSource) -> None:
        with self._changed:
            settings = self._settings()
            trigger = settings.triggers[which]
            if not self._running or not trigger.mode or trigger.source != source:
                return
            if self._faults.active("miss"):
                return
            if which is Trigger.ACQUISITION_START:
                accepted = self._permitted == 0
                if accepted:
                    self._permitted = settings.acquisition_frame_count
                    self._changed.notify_all()
                kind = EventKind.ACQUISITION_START if accepted else EventKind.ACQUISITION_START_OVERTRIGGER
                self._report(kind, 0, self._clock.now_ns())
                return
            self._fire_frame(settings, trigger)

    def _fire_frame(self, settings: CameraSettings, trigger: TriggerSettings) -> None:
        if self._permitted == 0 or self._is_busy():
            self._missed_triggers += 1
            self._report(EventKind.FRAME_START_OVERTRIGGER, 0, self._clock.now_ns())
            return
        late_us = trigger.delay_us + self._faults.amount("late") * 1e3
        moment_ns = self._moments.stamp_trigger(self._name) + round(late_us * 1e3)
        position = self._source.place()
        number = self._triggers.next(None if position is None else (settings.frame(), position))
        self._waiting.append(self._schedule_exposure(settings, max(moment_ns, self._ready_ns), number))
        self._changed.notify_all()

    def _is_busy(self) -> bool:
        return len(self._waiting) >= FRAMES_IN_PROGRESS or self._clock.now_ns() < self._ready_ns

    def _schedule_exposure(self, settings: CameraSettings, start_ns: int, number: int) -> _Exposure:
        """Schedule a frame and count it against the frame limit of the acquisition or its trigger."""
        frame = replace(settings.frame(), line_lit=self._is_line_lit())
        self._exposed_ns = (start_ns, start_ns + frame.exposure_us * 1000)
        self._ready_ns = start_ns + round(shortest_period_us(frame) * 1e3)
        if self._permitted is not None:
            self._permitted -= 1
        if settings.acquisition_mode == AcquisitionMode.SINGLE_FRAME:
            self._running = False
        self._report(EventKind.FRAME_START, 0, start_ns)
        return _Exposure(self._acquisition, number, start_ns, frame)

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._closed and not self._waiting and not self._is_free_running():
                    self._changed.wait(IDLE_CHECK_S)
                if self._closed:
                    return
                triggered = bool(self._waiting)
                exposure = self._waiting[0] if triggered else self._schedule_next_free()
            self._take(exposure, triggered)

    def _is_free_running(self) -> bool:
        settings = self._settings()
        return (
            self._running
            and not settings.triggers[Trigger.FRAME_START].mode
            and self._permitted != 0
            and self._channel.receiver is not None
        )

    def _schedule_next_free(self) -> _Exposure:
        settings = self._settings()
        now_ns = self._clock.now_ns()
        period_ns = round(free_running_period_us(settings) * 1e3)
        # A frame is sent while the next ones are exposed; only a stall makes the camera drop frames.
        lag_ns = round((settings.exposure_us + readout_us(settings.frame())) * 1e3) + FRAMES_LATE * period_ns
        start_ns = self._free_due_ns if now_ns - self._free_due_ns < lag_ns else now_ns
        self._free_due_ns = start_ns + period_ns
        self._free_frames += 1
        return self._schedule_exposure(settings, start_ns, self._free_frames)

    def _take(self, exposure: _Exposure, triggered: bool) -> None:
        began_s = time.monotonic()
        frame = exposure.frame
        if triggered:
            image = self._source.triggered(frame, exposure.number)
        else:
            frame, image = self._source.running(frame, exposure.number)
        exposed_ns = exposure.start_ns + frame.exposure_us * 1000
        read_ns = exposed_ns + round(readout_us(frame) * 1e3)
        # In real time rows are sent while they are read out, in lock-step once the time has passed.
        self._clock.wait_until_ns(exposed_ns if self._clock.paced else read_ns)
        with self._changed:
            if exposure.acquisition != self._acquisition:
                return
            if triggered:
                self._waiting.popleft()
            block = self._channel.block_of(SentImage(frame, image, self._ticks.stamp(exposure.start_ns)))
        if block is not None:
            self._report(EventKind.EXPOSURE_END, block.block_id, exposed_ns)
            self._channel.send(block, (read_ns - self._clock.now_ns()) / 1e9)
        if not triggered and not self._clock.paced:
            # A free run in lock-step advances the theatre, but never faster than real time.
            spare_s = free_running_period_us(self._settings()) * 1e-6 - (time.monotonic() - began_s)
            time.sleep(max(0.0, spare_s))


class TriggerCounter:
    """Trigger counter whose value seeds the noise, so that retaking an image reproduces it.

    A client that has lost an image restarts the acquisition and triggers again. As long as it has changed
    neither the settings nor the camera's position, that trigger gets the previous number: an image lost on
    its way to the client changes none of those that follow.
    """

    def __init__(self) -> None:
        self._number = 0
        self._view: object = None
        self._started = False

    def start(self) -> None:
        """Mark the start of an acquisition."""
        self._started = False

    def next(self, view: object) -> int:
        """Return the number of the next trigger, given everything the image depends on (None if unknown)."""
        if self._started:
            self._number += 1
        elif view is None or view != self._view:
            self._number = 1
        self._started, self._view = True, view
        return self._number
