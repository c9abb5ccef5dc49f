"""Stand-ins that replay the recorded behaviour of operator, staff, clock and devices."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from typing import cast

from procedures.engine.errors import NotRecorded
from procedures.engine.replay.recorded_answers import RecordedAnswers
from procedures.journal.journal import Entry, Line
from procedures.operator.checkpoint import CONTINUE
from procedures.operator.question import Answer, Question, Task, Topic
from ronna_hw.devices.capabilities import ByteSink
from ronna_hw.devices.lifecycle import Device, LastKnown, Lifecycle, hold_active
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError
from ronna_hw.recording.reading_coding import (
    ANSWERS,
    PROPERTIES,
    RECORDED_PROPERTIES,
    StatesCalibration,
    list_recorded_calls,
)
from ronna_hw.roles import MASTER

AT_CHECKPOINTS = (Topic.PAUSE, Topic.GUARD, Topic.HEAD_UNSEEN)  # nobody pauses a replay, and it has no guards
# What older runs answered at the target, and the place of that answer among today's.
FORMER_WORDS = {"done": 0, "hold": -1}
KNOWN_UNOPENED = (
    "name",
    "wire_protocol",
    "kinematics",
    "tools",
    "markers_mm",
    "senses_force",
    "force_error_N",
    "has_projector",
    "projector_on",
)  # as configured
KNOWN_MEMBERS = {*ANSWERS, *RECORDED_PROPERTIES, *PROPERTIES, *KNOWN_UNOPENED}
READINGS = ("read_frame", "grab_pair", "read_state", "move")


class RecordedOperator:
    """Operator of a replay, who repeats the answers recorded in the journal."""

    def __init__(self) -> None:
        # After how many motions of the section, and which arm moved next.
        self._confirmations: list[tuple[int, str, Line]] = []

    def begin(self, section: Sequence[Line]) -> None:
        """Load the journal lines of a new section."""
        self._confirmations = []
        moving = [str(line.get("arm", MASTER)) for line in section if line["entry"] == Entry.MOTION]
        motions = 0
        for line in section:
            motions += line["entry"] == Entry.MOTION
            if line["entry"] == Entry.CONFIRMATION:
                next_to_move = moving[motions] if motions < len(moving) else MASTER
                self._confirmations.append((motions, next_to_move, line))

    def find_first_to_move(self, motions: int) -> str | None:
        """Return the arm whose first motion the next question after `motions` motions concerned, if any."""
        for asked_after, arm, line in self._confirmations:
            topic = str(line["topic"]).partition(":")[0]
            if topic not in AT_CHECKPOINTS:
                return arm if topic == Topic.FIRST_MOTION and asked_after == motions else None
        return None

    def ask(self, question: Question) -> Answer:
        """Return the recorded answer to the next question of this name. Raises PRO-024 if there is none."""
        for place, (_, _, line) in enumerate(self._confirmations):
            if line["topic"] == question.name:
                del self._confirmations[: place + 1]
                word = str(line["answer"])
                if word not in question.answers and word in FORMER_WORDS:
                    word = question.answers[FORMER_WORDS[word]]
                return Answer(word)
        if question.topic is Topic.PAUSE:  # a guard asked in its place
            return Answer(CONTINUE)
        raise NotRecorded(f"the run did not ask {question.name}: {question.subject}")


class RecordedRoom:
    """Room staff stand-in that repeats recorded readings; recorded controller inputs identify the tools."""

    def __init__(self) -> None:
        self._work: list[Line] = []

    def begin(self, work: Sequence[Line]) -> None:
        """Load the journal's work lines of a new section."""
        self._work = list(work)

    def announce(self, step: str) -> None:
        """Do nothing."""

    def change_tool(self, number: int, description: str) -> None:
        """Do nothing."""

    def prepare_stand(self, holds: str) -> None:
        """Do nothing."""

    def work(self, task: Task) -> tuple[float, ...]:
        """Return the recorded readings of the next task of this name. Raises PRO-024 if there are none."""
        for place, line in enumerate(self._work):
            if line["task"] == task.name:
                del self._work[: place + 1]
                readings = line["readings"]
                return tuple(map(float, readings)) if isinstance(readings, list) else ()
        raise NotRecorded(f"this was not done in the run: {task.subject}")


class RecordedClock:
    """Replay clock that shows the theatre time of the latest answer. Sleeping takes no time."""

    def __init__(self, answers: RecordedAnswers) -> None:
        self._answers = answers

    @property
    def paced(self) -> bool:
        return self._answers.opening.paced

    def now_s(self) -> float:
        return self._answers.moment_s

    def sleep(self, duration_s: float) -> None:
        """Return at once."""

    def let_pass(self, duration_s: float) -> None:
        """Do nothing: the time is that of the answers."""

    def hold_back(self) -> None:
        """Do nothing: the time is that of the answers."""


def make_stand_in(device: Device, answers: RecordedAnswers) -> Device:
    """Build a stand-in with a device's public interface and recorded answers, without opening the device."""
    own = vars(_StandIn)
    names = [name for name in dir(device) if not name.startswith("_") and name not in own]
    calls = list_recorded_calls(device)
    members = {
        name: _build_member(name, calls)
        for name in names
        if name in KNOWN_MEMBERS or not _is_property(device, name)
    }
    return cast("Device", type("Replayed", (_StandIn,), members)(device, answers))


class _StandIn:
    """Device stand-in whose state and latest reading come from recorded answers."""

    def __init__(self, device: Device, answers: RecordedAnswers) -> None:
        self._device = device
        self._answers = answers
        self.last_properties: dict[str, object] = {
            "serials": ("", ""),
            "notices": (),
            "operating_mode": OperatingMode.AUTOMATIC,
            "stated_calibration": (),
        }
        self._known: LastKnown[object] = LastKnown(Lifecycle.DISCONNECTED, None, None)

    @property
    def state(self) -> Lifecycle:
        return self._known.state

    @property
    def fault(self) -> RonnaError | None:
        return self._known.fault

    def observe(self) -> LastKnown[object]:
        return self._known

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Device]:
        return hold_active(cast("Device", self), timeout_s)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        self._known = LastKnown(Lifecycle.CONFIGURED, None, self._known.reading)

    def stop(self, *_how: object) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def record_bytes(self, sink: ByteSink | None) -> None:
        """Do nothing."""

    def answer(self, call: str) -> object:
        """Return the next recorded answer to a call, or raise the recorded error."""
        given = self._answers.next(self._device.name, call, list_recorded_calls(self._device)[call])
        if self._answers.is_peeking and given.error is None:
            return given.value
        fault = given.error if given.state is Lifecycle.FAULT else None
        newest = given.value if call in READINGS and given.error is None else self._known.reading
        self._known = LastKnown(given.state, fault, newest)
        self.last_properties.update(given.properties)
        if isinstance(self._device, StatesCalibration) and "stated_calibration" in given.properties:
            self._device.adopt_calibration(cast("tuple[float, ...]", given.properties["stated_calibration"]))
        if given.error is not None:
            raise given.error
        return given.value


def _build_member(name: str, calls: Collection[str]) -> object:
    if name in calls:
        return _build_call(name)
    if name in PROPERTIES:
        return property(lambda self: self.last_properties[name])
    if name in KNOWN_UNOPENED:
        return property(lambda self: getattr(self._device, name))
    if name in RECORDED_PROPERTIES:
        return property(lambda self: self._answers.look(self._device.name, name))
    return _build_refusal(name)


def _is_property(device: Device, name: str) -> bool:
    return isinstance(getattr(type(device), name, None), property)


def _build_call(name: str) -> Callable[..., object]:
    def return_answer(self: _StandIn, *_arguments: object, **_more: object) -> object:
        return self.answer(name)

    return return_answer


def _build_refusal(name: str) -> Callable[..., object]:
    def refuse(self: _StandIn, *_arguments: object, **_more: object) -> object:
        raise NotRecorded(f"{self._device.name}.{name} is not recorded")

    return refuse
