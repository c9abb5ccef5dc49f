"""The tape read back: for each section, what each call on each device gave, in order."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from procedures.engine.errors import NotRecorded
from ronna_hw.bounded_input import parse_json, read_json_lines
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import DeviceError, RonnaError, concrete_errors
from ronna_hw.host.regular_file import open_regular
from ronna_hw.recording.device_calls import ANSWERS, PROPERTIES
from ronna_hw.recording.pixel_coding import unpack_pixels
from ronna_hw.recording.reading_coding import GetPixels, as_recorded
from ronna_hw.recording.reading_tape import PIXELS_FILE, READINGS_FILE, READINGS_FOLDER

Line = Mapping[str, object]


@dataclass(frozen=True)
class RecordedAnswer:
    """What a call gave or raised, the state it left, and what the device then knew of itself."""

    state: Lifecycle
    value: object = None
    properties: Mapping[str, object] = field(default_factory=dict)
    error: RonnaError | None = None


@dataclass
class RecordedAnswers:
    """What the devices of one run answered. `moment_s` is the theatre time of the last that was given."""

    opening: Line
    _pixels: Path
    _sections: Mapping[int, Mapping[tuple[str, str], deque[Line]]]
    moment_s: float = 0.0
    peeks: bool = False
    _section: Mapping[tuple[str, str], deque[Line]] = field(default_factory=dict)

    def begin(self, section: int) -> None:
        """From here on the answers are those of that section."""
        self._section = self._sections.get(section, {})

    @contextmanager
    def peeking(self) -> Iterator[None]:
        """Within, answers are given and stay: who asks now asked before the step began, off the tape."""
        self.peeks = True
        try:
            yield
        finally:
            self.peeks = False

    def look(self, device: str, name: str) -> object:
        """The next value of a property, or the last once more: how often it is read does not matter."""
        waiting = self._section.get((device, name))
        if not waiting:
            raise NotRecorded(f"the run did not read {device}.{name} in this step")
        line = waiting.popleft() if len(waiting) > 1 else waiting[0]
        return line.get("answer")

    def next(self, device: str, call: str) -> RecordedAnswer:
        """The next answer to that call. Raises PRO-024."""
        waiting = self._section.get((device, call))
        if not waiting:
            raise NotRecorded(f"the run has no further answer of {device} to {call} in this step")
        line = waiting[0] if self.peeks else waiting.popleft()
        self.moment_s = max(self.moment_s, _number(line["theatre_time_s"]))
        state = Lifecycle(str(line["state"]))
        if "error" in line:
            return RecordedAnswer(state, error=_error(line["error"]))
        value = self.value_of(device, call, line.get("answer"))
        try:
            told = line.get("properties", {})
            properties = {
                name: _value(PROPERTIES[name], part, self._get_pixels)
                for name, part in (told.items() if isinstance(told, dict) else ())
            }
        except (ValueError, KeyError, TypeError) as error:
            raise NotRecorded(f"the answer of {device} to {call} is damaged: {error}") from error
        return RecordedAnswer(state, value, properties)

    def value_of(self, device: str, call: str, plain: object) -> object:
        """A recorded answer as the call gave it, with its pixels. Raises PRO-024 for what is damaged."""
        try:
            return _value(ANSWERS[call], plain, self._get_pixels)
        except (ValueError, KeyError, TypeError) as error:
            raise NotRecorded(f"the answer of {device} to {call} is damaged: {error}") from error

    def _get_pixels(self, where: dict[str, int | str | list[int]]) -> NDArray[np.uint8] | NDArray[np.uint16]:
        at, count, shape = where["at"], where["bytes"], where["shape"]
        if not isinstance(at, int) or not isinstance(count, int) or not isinstance(shape, list):
            raise NotRecorded("a reference to pixels is damaged")
        with open_regular(self._pixels) as file:
            file.seek(at)
            packed = file.read(count)
        try:
            return unpack_pixels(packed, (shape[0], shape[1]), str(where["type"]))
        except ValueError as error:
            raise NotRecorded(f"the pixels at byte {at} of {PIXELS_FILE} are damaged: {error}") from error


def read_answers(run: Path) -> RecordedAnswers:
    """Read a run's tape; a torn last line is left out. Raises PRO-024 when there is none."""
    sections: dict[int, dict[tuple[str, str], deque[Line]]] = defaultdict(lambda: defaultdict(deque))
    opening: Line | None = None
    for line in _lines(run / READINGS_FOLDER):
        if "opening" in line:
            opening = cast("Line", line["opening"])
        else:
            sections[cast("int", line["section"])][str(line["device"]), str(line["call"])].append(line)
    if opening is None:
        raise NotRecorded(f"{READINGS_FILE} has no first line")
    return RecordedAnswers(opening, run / READINGS_FOLDER / PIXELS_FILE, sections)


class ToldAt(NamedTuple):
    """An answer that was no error, and when it was given."""

    theatre_time_s: float
    value: object


def read_in_order(run: Path) -> Iterator[tuple[int, str, str, ToldAt]]:
    """Section, device, call and answer of all calls that raised nothing, as they came. Raises PRO-024."""
    answers = read_answers(run)
    for line in _lines(run / READINGS_FOLDER):
        call = str(line.get("call"))
        if call not in ANSWERS or ANSWERS[call] is None or "error" in line:
            continue
        section, device = cast("int", line["section"]), str(line["device"])
        told = ToldAt(_number(line["theatre_time_s"]), answers.value_of(device, call, line["answer"]))
        yield section, device, call, told


def _lines(folder: Path) -> Iterator[Line]:
    """Openings and answers, in order; what a process was writing when it was killed is left out."""
    try:
        lines = read_json_lines(folder / READINGS_FILE).splitlines(keepends=True)
    except OSError as error:
        raise NotRecorded(f"{folder} has no readings: {error.strerror}") from error
    torn = 0
    for number, text in enumerate(lines, start=1):
        if not text.strip():
            continue
        try:
            line = parse_json(text)
        except ValueError:
            torn = torn or number
            continue
        if not isinstance(line, dict):
            raise NotRecorded(f"line {number} of {READINGS_FILE} is damaged: not a JSON object")
        if "opening" in line:  # of the next process of the run: what the last one was writing may be torn
            torn = 0
        elif torn:
            raise NotRecorded(f"line {torn} of {READINGS_FILE} is not JSON")
        elif "section" not in line:
            continue
        elif missing := {"device", "call"} - line.keys():
            raise NotRecorded(
                f"line {number} of {READINGS_FILE} is damaged: no {' or '.join(sorted(missing))}"
            )
        yield line


def _value(kind: object, plain: object, get: GetPixels) -> object:
    return None if kind is None else as_recorded(kind, plain, get)


def _error(content: object) -> RonnaError:
    """An error of the class that was raised, where it is known here."""
    told = content if isinstance(content, dict) else {}
    code, name = told.get("code"), told.get("class")
    kinds = (kind for kind in concrete_errors() if kind.code == code and kind.__qualname__ == name)
    kind = next(kinds, DeviceError)
    error = kind.__new__(kind)  # some take other arguments than their base
    RonnaError.__init__(
        error,
        str(told.get("what", "")),
        expected=told.get("expected"),
        limit=told.get("limit"),
        got=told.get("got"),
    )
    return error


def _number(value: object) -> float:
    if not isinstance(value, int | float):
        raise NotRecorded(f"{value!r} is not a time")
    return float(value)
