"""Tape of all device answers to a procedure, in order, for replay.

    RUN/readings/readings.jsonl   one line per answer, in sections
    RUN/readings/pixels.bin       the pixels that these lines refer to, each packed separately

A section lies between two lines of the journal, and has the number of the first. Answers to other callers, a
guard or another thread, are not on the tape. A separate thread packs and writes.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, cast

from ronna_hw.devices.lifecycle import Device, Lifecycle, hold_active
from ronna_hw.devices.readings import StereoReading, TrackerFrame
from ronna_hw.errors import RonnaError
from ronna_hw.logs import logger
from ronna_hw.recording.reading_coding import (
    IDENTIFYING_CALLS,
    PROPERTIES,
    RECORDED_PROPERTIES,
    as_plain,
    list_recorded_calls,
    pack_pixels,
)

READINGS_FOLDER = "readings"
READINGS_FILE, PIXELS_FILE = "readings.jsonl", "pixels.bin"
MOST_BYTES = 2_000_000_000  # per run: ten full cases
MOST_WAITING_BYTES = 400_000_000  # of pixels: fifty pairs of full sensors
WRITE_PERIOD_S = 0.05  # host time
CLOSE_LIMIT_S = 10.0  # for what is still queued
NO_SECTION = -1
TAPPED = (TrackerFrame, StereoReading)  # readings that a tap gets, too: those of an arm are in shared memory
Tap = Callable[[Any], None]  # never blocks, never raises


class RecordedCall(NamedTuple):
    """Answer to a device call: a value or a raised error, and the resulting state."""

    section: int
    device: str
    call: str
    state: Lifecycle
    theatre_time_s: float
    value: object
    error: RonnaError | None
    properties: Mapping[str, object]  # of the device, if the call reveals them


class ReadingTape:
    """Tape of one run.

    `opening` is the first line: what a replay needs in addition to the answers.
    """

    def __init__(
        self,
        folder: Path,
        now_s: Callable[[], float],
        opening: Mapping[str, Any],
        *,
        most_bytes: int = MOST_BYTES,
        starts: bool = True,
    ) -> None:
        """Continue the tape left by an earlier process of the run, at once or on `start`. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        self._lines = (folder / READINGS_FILE).open("ab")
        self._pixels = (folder / PIXELS_FILE).open("ab")
        self._now_s = now_s
        self._most_bytes = most_bytes
        self._section = NO_SECTION
        self._thread = 0  # the one that reads within the section
        self._beside = 0
        self._queue: deque[RecordedCall] = deque()
        self._waiting_bytes = 0
        self._counting = threading.Lock()
        self._full = False
        self._ending = threading.Event()
        self._writing = threading.Lock()
        self._opening: Mapping[str, Any] | None = opening  # until it is written
        if starts:
            self.start()
        self._writer = threading.Thread(target=self._run, name="reading tape", daemon=True)
        self._writer.start()

    def start(self) -> None:
        """Write the opening line. Until then nothing is written, and the tape is as it was left."""
        with self._writing:
            if self._opening is None:
                return
            if self._lines.tell():
                self._lines.write(b"\n")  # terminates a torn line
            self._write_line({"opening": dict(self._opening)})
            self._opening = None

    def begin(self, section: int) -> None:
        """Record this thread's subsequent answers under section number `section`."""
        self._section, self._thread = section, threading.get_ident()

    def end(self) -> None:
        """End the current section."""
        self._section = NO_SECTION

    @contextmanager
    def in_this_thread(self) -> Iterator[None]:
        """Record the answers of this thread within the block, in place of the section's own, which waits."""
        before, self._thread = self._thread, threading.get_ident()
        try:
            yield
        finally:
            self._thread = before

    @contextmanager
    def beside(self) -> Iterator[None]:
        """Exclude readings within the block from the current section."""
        self._beside += 1
        try:
            yield
        finally:
            self._beside -= 1

    @property
    def is_listening(self) -> bool:
        """Whether answers to the current thread are recorded."""
        return self._section != NO_SECTION and not self._beside and threading.get_ident() == self._thread

    def keep(
        self,
        device: str,
        call: str,
        state: Lifecycle,
        value: object,
        error: RonnaError | None = None,
        properties: Mapping[str, object] = MappingProxyType({}),
    ) -> None:
        """Queue an answer for recording. Never blocks, never raises."""
        answer = RecordedCall(self._section, device, call, state, self._now_s(), value, error, properties)
        if self._count_waiting(_pixel_bytes(value)) > MOST_WAITING_BYTES:
            self._full = True
        if not self._full:
            self._queue.append(answer)

    def _count_waiting(self, more_bytes: int) -> int:
        """Update and return the bytes of queued pixels; both engine and writer call this."""
        with self._counting:
            self._waiting_bytes += more_bytes
            return self._waiting_bytes

    def close(self) -> None:
        """Write queued answers and close the files. Bounded in time; never raises."""
        self._ending.set()
        self._writer.join(CLOSE_LIMIT_S)

    def settle(self) -> None:
        """Write all queued answers, so that a later kill loses none of them. Never raises."""
        with self._writing:
            if self._lines.closed or self._opening is not None:
                return
            try:
                self._write_waiting()
            except (OSError, TypeError, ValueError) as error:  # the disk, or an answer of unknown form
                self._full = True
                self._queue.clear()
                logger(part="reading tape").warning("readings are no longer recorded", cause=error)
                self._close_files()

    def _run(self) -> None:
        while not self._ending.wait(WRITE_PERIOD_S):
            self.settle()
        self.settle()
        with self._writing:
            if self._full and self._opening is None and not self._lines.closed:
                with suppress(OSError):
                    self._write_line({"full": True})
            self._close_files()

    def _close_files(self) -> None:
        for file in (self._lines, self._pixels):
            with suppress(OSError):
                file.close()

    def _write_waiting(self) -> None:
        while self._queue:
            answer = self._queue.popleft()
            self._write(answer)
            self._count_waiting(-_pixel_bytes(answer.value))
        self._lines.flush()
        self._pixels.flush()
        if self._lines.tell() + self._pixels.tell() > self._most_bytes:
            self._full = True

    def _write(self, answer: RecordedCall) -> None:
        kept_fields = ("section", "device", "call", "state", "theatre_time_s")
        line: dict[str, Any] = {name: getattr(answer, name) for name in kept_fields}
        if (error := answer.error) is not None:
            error_fields = {name: getattr(error, name) for name in ("what", "expected", "limit", "got")}
            line["error"] = {"code": error.code, "class": type(error).__qualname__, **error_fields}
        else:
            line["answer"] = as_plain(answer.value, self._put_pixels)
        if answer.properties:
            known = answer.properties.items()
            line["properties"] = {name: as_plain(value, self._put_pixels) for name, value in known}
        self._write_line(line)

    def _put_pixels(self, pixels: Any) -> dict[str, Any]:
        packed = pack_pixels(pixels)
        at = self._pixels.tell()
        self._pixels.write(packed)
        return {"at": at, "bytes": len(packed), "shape": list(pixels.shape), "type": str(pixels.dtype)}

    def _write_line(self, content: Mapping[str, Any]) -> None:
        self._lines.write(json.dumps(content, separators=(",", ":")).encode() + b"\n")


def _pixel_bytes(value: object) -> int:
    if not isinstance(value, StereoReading):
        return 0
    return sum(side.pixels.nbytes for side in (value.left, value.right) if side is not None)


def tape_device(device: Device, tape: ReadingTape, tap: Tap | None = None) -> Device:
    """Wrap a device to record its answers; the wrapper exposes exactly the device's public names.

    The `tap` gets the readings of every thread, in a section or not.
    """
    names = [name for name in dir(device) if not name.startswith("_") and name != "active"]
    calls = list_recorded_calls(device)
    members = {name: _make_member(name, calls, tap) for name in names}
    return cast("Device", type("Taped", (_TapedDevice,), members)(device, tape))


class _TapedDevice:
    """Recording wrapper with the members of the wrapped device."""

    def __init__(self, device: Device, tape: ReadingTape) -> None:
        self._device = device
        self._tape = tape

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Any]:
        return hold_active(cast("Device", self), timeout_s)


def _make_member(name: str, calls: Mapping[str, Any], tap: Tap | None) -> Any:
    if name in calls:
        return _make_taped_call(name, tap if calls[name] in TAPPED else None)
    if name in RECORDED_PROPERTIES:
        return property(lambda self: _call_and_keep(self, name, lambda: getattr(self._device, name)))
    return property(lambda self: getattr(self._device, name))


def _make_taped_call(name: str, tap: Tap | None) -> Callable[..., Any]:
    def call(self: _TapedDevice, *arguments: Any, **more: Any) -> Any:
        value = _call_and_keep(self, name, lambda: getattr(self._device, name)(*arguments, **more))
        if tap is not None:
            tap(value)
        return value

    return call


def _call_and_keep(self: _TapedDevice, name: str, call_device: Callable[[], Any]) -> Any:
    device, tape = self._device, self._tape
    if not tape.is_listening:
        return call_device()
    try:
        value = call_device()
    except RonnaError as error:
        tape.keep(device.name, name, device.observe().state, None, error)
        raise
    known = PROPERTIES if name in IDENTIFYING_CALLS else ()
    properties = {one: getattr(device, one) for one in known if hasattr(device, one)}
    tape.keep(device.name, name, device.observe().state, value, properties=properties)
    return value
