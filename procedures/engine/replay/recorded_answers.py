"""Reading tape of a run: the recorded answers to all device calls, divided into sections."""

from __future__ import annotations

import json
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from procedures.engine.errors import NotRecorded, ReadingsChanged
from procedures.engine.methods import CaseMethods
from procedures.engine.setting import ClinicalInput
from procedures.journal.journal import ENDS_OF_A_STEP, Entry
from procedures.journal.recorded_roles import RecordedRoles
from ronna_hw.bounded_input import InputRefused, parse_json, read_json_lines
from ronna_hw.clock import Clock
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import DeviceError, ErrorCode, RonnaError, find_code
from ronna_hw.host.files import open_regular
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.recording import reading_coding
from ronna_hw.recording.reading_tape import PIXELS_FILE, READINGS_FILE, READINGS_FOLDER, ReadingTape
from ronna_hw.roles import ONE_ARM

Count = Annotated[int, Field(gt=0, le=reading_coding.LARGEST_BYTES)]
BEGINS = (Entry.INTENT, Entry.HOME)


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True)


class CalibrationOpening(_Strict):
    """Recipe of a recorded calibration, and the calibration records it used."""

    recipe: dict[str, object]
    records: dict[str, object]


class Opening(_Strict):
    """Opening line of a process on the tape, with everything besides answers that a replay needs."""

    theatre_file: str | None = None
    paced: bool = False
    series: str | None = None
    plan: str | None = None
    strategy: str | None = None
    methods: CaseMethods = CaseMethods()
    measure_targets: bool = False
    intraoperative: bool = False
    roles: RecordedRoles = ONE_ARM
    began: Annotated[AwareDatetime | None, Field(strict=False)] = None
    calibration: CalibrationOpening | None = None


class _Raised(_Strict):
    """Recorded error of a device call."""

    code: str
    kind: str = Field(alias="class")
    what: str
    expected: str | None = None
    limit: str | None = None
    got: str | None = None

    def to_error(self) -> RonnaError:
        """Rebuild the raised error, as that of its code if that is known."""
        known = find_code(self.code) or DeviceError
        if isinstance(known, ErrorCode):
            return known(self.what, expected=self.expected, limit=self.limit, got=self.got)
        error = known.__new__(known)  # some take other arguments than their base
        RonnaError.__init__(error, self.what, expected=self.expected, limit=self.limit, got=self.got)
        return error


class _AnswerLine(_Strict):
    """Tape line with an answer."""

    section: int
    device: str
    call: Annotated[str, AfterValidator(lambda call: reading_coding.RENAMED.get(call, call))]
    state: Annotated[Lifecycle, Field(strict=False)]
    theatre_time_s: FiniteFloat
    answer: object = None
    error: _Raised | None = None
    properties: dict[str, object] = {}


class _PixelsAt(_Strict):
    """Position of an image's pixel data on the tape."""

    at: Annotated[int, Field(ge=0, lt=2**63)]
    count: Annotated[Count, Field(alias="bytes")]
    shape: Annotated[tuple[Count, Count], Field(strict=False)]
    type: str


@dataclass(frozen=True)
class RecordedAnswer:
    """Recorded outcome of a device call: value or error, device state and properties."""

    state: Lifecycle
    value: object = None
    properties: Mapping[str, object] = field(default_factory=dict)
    error: RonnaError | None = None


@dataclass
class RecordedAnswers:
    """Recorded device answers of one run; `moment_s` is the theatre time of the last one returned."""

    opening: Opening
    _pixels: Path
    _sections: Mapping[int, Mapping[tuple[str, str], deque[_AnswerLine]]]
    moment_s: float = 0.0
    is_peeking: bool = False
    _section: Mapping[tuple[str, str], deque[_AnswerLine]] = field(default_factory=dict)

    def begin(self, section: int) -> None:
        """Switch to a section and to its theatre time, since each process may have had its own clock."""
        self._section = self._sections.get(section, {})
        given_s = (line.theatre_time_s for lines in self._section.values() for line in lines)
        self.moment_s = min(given_s, default=self.moment_s)

    @contextmanager
    def peek(self) -> Iterator[None]:
        """Return answers during the block without consuming them, as for checks before a step."""
        self.is_peeking = True
        try:
            yield
        finally:
            self.is_peeking = False

    def look(self, device: str, name: str) -> object:
        """Return the next recorded value of a property; the last one repeats. Raises PRO-024."""
        waiting = self._section.get((device, name))
        if not waiting:
            raise NotRecorded(f"the run did not read {device}.{name} in this step")
        line = waiting.popleft() if len(waiting) > 1 else waiting[0]
        return self.value_of(device, name, line.answer, reading_coding.RECORDED_PROPERTIES[name])

    def next(self, device: str, call: str, kind: object) -> RecordedAnswer:
        """Return the next recorded answer to a call, parsed as `kind`. Raises PRO-024."""
        waiting = self._section.get((device, call))
        if not waiting:
            raise NotRecorded(f"the run has no further answer of {device} to {call} in this step")
        line = waiting[0] if self.is_peeking else waiting.popleft()
        self.moment_s = max(self.moment_s, line.theatre_time_s)
        if line.error is not None:
            return RecordedAnswer(line.state, error=line.error.to_error())
        value = self.value_of(device, call, line.answer, kind)
        try:
            properties = {
                name: _parse_value(reading_coding.PROPERTIES[name], part, self._get_pixels)
                for name, part in line.properties.items()
            }
        except NotRecorded:
            raise
        except (ValueError, KeyError, TypeError) as error:
            raise ReadingsChanged(f"the answer of {device} to {call} is damaged: {error}") from error
        return RecordedAnswer(line.state, value, properties)

    def value_of(self, device: str, call: str, plain: object, kind: object) -> object:
        """Parse a recorded answer as `kind`, loading any pixels. Raises PRO-024 for damaged data."""
        try:
            return _parse_value(kind, plain, self._get_pixels)
        except NotRecorded:
            raise
        except (ValueError, KeyError, TypeError) as error:
            raise ReadingsChanged(f"the answer of {device} to {call} is damaged: {error}") from error

    def _get_pixels(self, where: object) -> NDArray[np.uint8] | NDArray[np.uint16]:
        place, packed = _PixelsAt.model_validate(where), b""
        try:
            with open_regular(self._pixels) as file:
                file.seek(place.at)
                packed = file.read(place.count)
            return reading_coding.unpack_pixels(packed, place.shape, place.type)
        except (OSError, ValueError) as error:
            why = error.summary if isinstance(error, InputRefused) else str(error)
            # A file that ends before them has lost its last block, as after a power failure.
            kind = ReadingsChanged if len(packed) == place.count else NotRecorded
            raise kind(f"the pixels at byte {place.at} of {PIXELS_FILE} are damaged: {why}") from error


def read_answers(run: Path) -> RecordedAnswers:
    """Read a run's tape, ignoring a torn last line. Raises PRO-024 if there is no tape."""
    sections: dict[int, dict[tuple[str, str], deque[_AnswerLine]]] = defaultdict(lambda: defaultdict(deque))
    opening: Opening | None = None
    for line in _read_lines(run / READINGS_FOLDER):
        if isinstance(line, Opening):
            opening = line
        else:
            sections[line.section][line.device, line.call].append(line)
    if opening is None:
        raise NotRecorded(f"{READINGS_FILE} has no first line")
    return RecordedAnswers(opening, run / READINGS_FOLDER / PIXELS_FILE, sections)


class RecordedReading(NamedTuple):
    """Successful answer on the tape. `load` parses its value and raises PRO-024 if it is damaged."""

    section: int
    device: str
    call: str
    theatre_time_s: float
    kind: object  # type of the value
    load: Callable[[], object]


def iterate_readings(run: Path) -> Iterator[RecordedReading]:
    """Yield all successful answers in order, without loading their pixels. Raises PRO-024."""
    answers = read_answers(run)
    for line in _read_lines(run / READINGS_FOLDER):
        if (
            isinstance(line, Opening)
            or reading_coding.ANSWERS.get(line.call) is None
            or line.error is not None
        ):
            continue
        kind = reading_coding.ANSWERS[line.call]
        load = partial(answers.value_of, line.device, line.call, line.answer, kind)
        yield RecordedReading(line.section, line.device, line.call, line.theatre_time_s, kind, load)


def describe_torn_end(run: Path) -> str:
    """Say that the last line of a run's tape is not JSON, as a kill leaves it; else empty. Raises INP-001."""
    name = f"{READINGS_FOLDER}/{READINGS_FILE}"
    try:
        lines = read_json_lines(run / name).rstrip().splitlines()
        parse_json(lines[-1] if lines else b"{}")
    except OSError as error:
        return f"{name}: cannot be read: {error.strerror}"
    except ValueError:
        return f"{name}: line {len(lines)}, the last, is torn or no JSON; it is not read"
    return ""


def _read_lines(folder: Path) -> Iterator[Opening | _AnswerLine]:
    """Yield openings and answers in order, skipping lines torn when a process was killed."""
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
        is_opening = "opening" in line  # of the next process of the run: what the last one wrote may be torn
        if torn and not is_opening:
            raise NotRecorded(f"line {torn} of {READINGS_FILE} is not JSON")
        torn = 0
        try:
            if is_opening:
                yield Opening.model_validate(line["opening"])
            elif "section" in line:
                yield _AnswerLine.model_validate(line)
        except ValidationError as error:
            why = "; ".join(describe_mistakes(error))
            raise NotRecorded(f"line {number} of {READINGS_FILE} is damaged: {why}") from error


def _parse_value(kind: object, plain: object, get: reading_coding.GetPixels) -> object:
    return None if kind is None else reading_coding.as_recorded(kind, plain, get)


def section_follower(tape: ReadingTape) -> Callable[[bytes], None]:
    """Return a journal callback that divides the tape into sections.

    The answers of devices to a step, or on the way home, are one section, numbered by its first line.
    """

    def follow(line: bytes) -> None:
        content = json.loads(line)
        if content["entry"] in BEGINS:
            tape.begin(content["sequence"])
        elif content["entry"] in ENDS_OF_A_STEP:
            tape.end()

    return follow


def opening_line(
    folder: Path,
    theatre_file: Path,
    clock: Clock,
    clinical: ClinicalInput | None,
    began: datetime,
    calibration: Mapping[str, object] | None = None,
) -> dict[str, object]:
    """Return the contents of an opening line, with relative paths for files in the run folder.

    `calibration` has the steps of a calibration and the records that were in use.
    """

    def relative_path(path: Path) -> str:
        inside, whole = folder.resolve(), path.resolve()
        return str(whole.relative_to(inside) if whole.is_relative_to(inside) else whole)

    return {
        "theatre_file": relative_path(theatre_file),
        "paced": clock.paced,
        "series": None if clinical is None else relative_path(clinical.series),
        "plan": None if clinical is None else relative_path(clinical.plan),
        "strategy": None if clinical is None else clinical.strategy.name,
        "methods": asdict(CaseMethods() if clinical is None else clinical.methods),
        "measure_targets": clinical is not None and clinical.measure_targets,
        "intraoperative": clinical is not None and clinical.intraoperative,
        "roles": list(ONE_ARM if clinical is None else clinical.roles),
        "began": began.isoformat(),
        "calibration": calibration,
    }
