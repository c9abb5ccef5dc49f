"""Feed of a running case: what steps, guards and the arms' streams read anyhow, for its log and its readers.

A tap in the wrapper of every device queues each reading of any thread. The feed's own thread looks from time
to time, adds the cycles in shared memory and the events of the case, and passes all on. Nothing here blocks
the run, asks a device or raises into it.
"""

from __future__ import annotations

import base64
import contextlib
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from procedures.engine.events import (
    Advisory,
    CaseState,
    DeviceState,
    Event,
    EventStream,
    Fault,
    JournalLine,
    StepState,
)
from procedures.live.arm_tap import ArmTap
from procedures.live.case_frames import CaseFrames
from procedures.live.feed_socket import FeedSocket
from procedures.live.flight_log import FlightLog, next_log_file
from procedures.live.log_entries import JournalEntry, Level, LogEntry, SaidLine, time_of
from procedures.live.log_topics import without_identity
from procedures.live.records import Began, CameraPicture, DeviceStatus, FramePose, LiveRecord, RunState
from ronna_hw.devices.readings import CameraImage, StereoReading, TrackerFrame, Validity
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame
from ronna_hw.logs import logger

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from ronna_hw.clock import Clock

# Host time between two looks: an arm's recorder holds more cycles, at a controller's pace and in lock-step.
PACED_PERIOD_S, LOCK_STEP_PERIOD_S = 0.2, 0.1
READ_PERIOD_S = 1 / 60  # host time, while somebody reads
MOST_WAITING = 2_000  # readings
JPEG_QUALITY = 85
TWELVE_BITS_TO_EIGHT = 4
_log = logger(part="live feed")


class LiveFeed:
    """Feed of one program of a run."""

    def __init__(self, folder: Path, clock: Clock, events: EventStream) -> None:
        """Take readings from now on; `follow` passes them on."""
        self._folder = folder
        self._clock = clock
        self._events = events.subscribe()
        self._last_s = clock.now_s()
        self._epoch_ns = time.time_ns() - round(self._last_s * 1e9)
        self._readings: deque[object] = deque(maxlen=MOST_WAITING)
        self._wake = threading.Event()
        self._ending = False
        self._failure = ""  # the last one that was logged
        self._state = RunState(theatre_time_s=0.0, run=folder.name, state="")
        self._arms: list[ArmTap] = []
        self._tools: dict[str, None] = {}  # of the tracker, in the order in which they came
        self._log: FlightLog | None = None
        self._socket: FeedSocket | None = None
        self._thread: threading.Thread | None = None

    def tap(self, reading: object) -> None:
        """Queue a reading. Never blocks; called from any thread."""
        self._readings.append(reading)
        if self._socket is not None and self._socket.has_readers:
            self._wake.set()

    def follow(self, engine: Engine) -> None:
        """Begin to pass on what the devices of an engine say."""
        workcell = engine.setting.workcell
        self._workcell, self._frames = workcell, CaseFrames(engine)
        self._arms = [
            ArmTap(arm, workcell.motion[role], self._now_s, self._clock)
            for role, arm in workcell.arms.items()
        ]
        began = Began(theatre_time_s=0.0, run=engine.case.run, epoch_ns=self._epoch_ns)
        self._state = self._state.model_copy(update={"run": engine.case.run})
        try:
            self._socket = FeedSocket(self._folder, began)
        except OSError as error:
            _log.warning("no program can read the case while it runs", cause=error)
        self._log = FlightLog(next_log_file(self._folder), began, engine.order.without_names)
        self._thread = threading.Thread(target=self._run, name="live feed", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Pass on what is queued, seal the log and end the readers' connections. Bounded; never raises."""
        self._ending = True
        self._wake.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._log is not None:
            self._log.close()

    def _now_s(self) -> float:
        with contextlib.suppress(ValueError):  # the clock ends with its theatre
            self._last_s = self._clock.now_s()
        return self._last_s

    def _run(self) -> None:
        entries: list[LogEntry] = []
        with contextlib.suppress(Exception):  # a kind of arm that nobody can draw
            entries += self._arms[0].draw()  # of the others the links would have the same names
        while True:
            ending = self._ending  # before the last look
            with self._noting():
                self._look(entries)
            entries = []
            if ending:
                return
            reads = self._socket is not None and self._socket.has_readers
            alone_s = PACED_PERIOD_S if self._clock.paced else LOCK_STEP_PERIOD_S
            self._wake.wait(READ_PERIOD_S if reads else alone_s)
            self._wake.clear()

    def _look(self, entries: list[LogEntry]) -> None:
        """Pass on what is new; the `entries` go to the log with it. A source that fails costs only itself."""
        events, shown = self._events.read(0.0).events, list[LiveRecord]()
        if any(not event.what.signal for event in events):
            with self._noting():
                shown += self._frames.changes(self._now_s())
        for event in events:
            with self._noting():
                shown += self._read_event(event, entries)
        with self._noting():
            shown += self._read_queue()
        entries += shown
        for arm in self._arms:
            with self._noting():
                if new := arm.look():
                    entries += new
                    shown += filter(None, (arm.latest_joints, arm.latest_pose))
        if self._log is not None:
            self._log.take(sorted(entries, key=time_of))
        if self._socket is not None:
            self._socket.offer(shown)

    @contextlib.contextmanager
    def _noting(self) -> Iterator[None]:
        """Log what fails in the block, once in a row for each text: a case goes on without its feed."""
        try:
            yield
        except Exception as problem:
            if (text := str(problem)) != self._failure:
                self._failure = text
                _log.warning("the live feed misses something", cause=problem)

    def _read_event(self, event: Event, entries: list[LogEntry]) -> Iterator[LiveRecord]:
        at_s = event.theatre_time_s
        match event.what:
            case JournalLine(line=line):
                entries.append(JournalEntry(at_s, without_identity(line)))
            case CaseState(state=state, reason=reason):
                change = {"state": state, "reason": reason, "theatre_time_s": at_s}
                self._state = self._state.model_copy(update=change)
                yield self._state
            case StepState(step=step, state=state, summary=summary):
                entries.append(SaidLine(at_s, Level.INFO, f"{step}: {summary or state}"))
                step = step if state == "begun" else ""
                self._state = self._state.model_copy(update={"step": step, "theatre_time_s": at_s})
                yield self._state
            case Advisory(text=text):
                entries.append(SaidLine(at_s, Level.WARNING, text))
            case Fault(code=code, what=what):
                entries.append(
                    SaidLine(at_s, Level.ERROR, what if what.startswith(code) else f"{code}: {what}")
                )
            case DeviceState(device=device, state=state, fault=fault):
                yield self._status(device, state, fault, at_s)
            case _:
                pass

    def _status(self, device: str, state: str, fault: str | None, at_s: float) -> DeviceStatus:
        found = DeviceStatus(theatre_time_s=at_s, device=device, state=state, text=fault or "")
        if fault is None or device not in self._workcell.devices:
            return found
        error = self._workcell.devices[device].observe().fault
        if not isinstance(error, RonnaError):
            return found
        return found.model_copy(update={"code": error.code, "text": error.summary, "advice": error.advice})

    def _read_queue(self) -> Iterator[LiveRecord]:
        while self._readings:
            reading = self._readings.popleft()
            if isinstance(reading, TrackerFrame):
                yield from self._tool_poses(reading)
            elif isinstance(reading, StereoReading):
                yield from _pictures(reading)

    def _tool_poses(self, frame: TrackerFrame) -> Iterator[FramePose]:
        """Yield the pose of every tool seen so far; one that is not in a lost or damaged frame has none."""
        at_s = frame.stamp.measured_s or frame.stamp.theatre_time_s
        seen = {tool.tool: tool for tool in frame.tools}
        self._tools |= dict.fromkeys(seen)
        for name in self._tools:
            tool = seen.get(name)
            lost = Validity.MISSING if frame.validity is Validity.OK else frame.validity
            yield FramePose(
                theatre_time_s=at_s,
                parent=Frame.TRACKER,
                child=name,
                rotation=None if tool is None else tool.rotation,
                translation_mm=None if tool is None else tool.position_mm,
                validity=lost if tool is None else tool.validity,
            )


def _pictures(pair: StereoReading) -> Iterator[CameraPicture]:
    sides: tuple[tuple[Literal["left", "right"], CameraImage | None], ...]
    sides = ("left", pair.left), ("right", pair.right)
    for side, image in sides:
        if image is not None:
            height, width = image.pixels.shape
            yield CameraPicture(
                theatre_time_s=image.stamp.measured_s or image.stamp.theatre_time_s,
                side=side,
                width=width,
                height=height,
                jpeg=base64.b64encode(_as_jpeg(image)).decode(),
            )


def _as_jpeg(image: CameraImage) -> bytes:
    import cv2
    import numpy as np

    pixels = image.pixels
    if pixels.dtype != np.uint8:
        pixels = (pixels >> TWELVE_BITS_TO_EIGHT).astype(np.uint8)
    _, encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return encoded.tobytes()
