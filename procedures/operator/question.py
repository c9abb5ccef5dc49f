"""Questions to the operator, tasks for the room staff, and the interfaces for both.

A question shows the value that is being decided on and is recorded with it. Silence is the last answer, which
never continues. Only one of the listed words answers; anything else is asked again.
"""

from __future__ import annotations

import hashlib
import json
import math
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from pydantic import BaseModel, Field

from procedures.operator.margin import LIMIT_BEYOND_MARGIN, MarginVerdict, judge_error
from ronna_hw.text import strip_unit


class Topic(StrEnum):
    """Question topics, combined with a trajectory where applicable, such as `approach:T1`."""

    PATIENT = "patient"  # that this is the patient and the plan
    RESUME = "resume"  # what was found again after a restart
    FIRST_MOTION = "first_motion"  # since the devices were connected or a stop
    HEAD_CLAMPED = "head_clamped"  # and the clamp locked to the table
    CART_PLACE = "cart_place"  # the cart stands elsewhere than its place was proposed
    CART_LOCKED = "cart_locked"  # its brakes are closed
    CART_MOVED = "cart_moved"  # or the tracker, after the localization: the case goes on from there
    SPHERE_COUNT = "sphere_count"  # the CT shows another number than were implanted
    UNMATCHED_SPHERE = "unmatched_sphere"  # one is not where the CT has it, as the tracker sees
    UNREACHABLE = "reach"  # the arm cannot reach a trajectory
    SPHERE = "sphere"  # the stereo head cannot measure one
    MOVED_SPHERE = "moved_sphere"  # one alone explains why the fit disagrees
    MARGIN = "margin"  # the predicted error exceeds the plan's
    REGISTRATION = "registration"
    REGISTRATION_KEPT = "registration_kept"  # after the arm was in fault
    TOOL_CHANGE = "tool_change"
    TOOL_TIP = "tool_tip"
    TOOL_CHECK = "tool_check"  # of the mounted tool on a gauge
    APPROACH = "approach"  # over an entry, and along the axis to where the guide is held
    DEPTH_STOP = "depth_stop"  # of the instrument, as it was computed and set
    WORK_BEGUN = "work_begun"  # through the guide, when it was there before: from which stage it goes on
    SKIN = "skin"  # opened through the guide
    DRILL = "drill"  # the skull is drilled
    SCANNED = "scanned"  # during the operation: of the head as it is clamped
    BREAKTHROUGH = "breakthrough"  # of the assistant's drill, too early or too late by the CT
    DURA = "dura"  # is opened
    AT_TARGET = "at_target"  # the instrument is at depth; the arm holds until this is answered
    INSTRUMENT_OUT = "instrument_out"  # of the guide: nothing moves before
    RETREAT = "retreat"
    PARK = "park"
    CALIBRATION = "calibration"
    PAUSE = "pause"
    GUARD = "guard"  # a guard suspends the step
    MOVE_FOLLOWED = "move_followed"  # the registration follows a measured move of the head
    HEAD_UNSEEN = "head_unseen"  # a guide is near a head that the tracker has not seen for too long
    REPEAT = "repeat"  # a step that is done: what a new result supersedes
    READING = "reading"  # what a dial or a gauge shows, typed at a console
    UNVERIFIED = "unverified"  # a controller that cannot say how it is set up


DELIBERATE = frozenset(
    (
        *(Topic.RESUME, Topic.FIRST_MOTION, Topic.REGISTRATION, Topic.REGISTRATION_KEPT, Topic.TOOL_CHECK),
        *(Topic.APPROACH, Topic.WORK_BEGUN, Topic.AT_TARGET, Topic.INSTRUMENT_OUT, Topic.RETREAT, Topic.PARK),
        *(Topic.CALIBRATION, Topic.PAUSE, Topic.HEAD_UNSEEN, Topic.MOVE_FOLLOWED, Topic.CART_MOVED),
        *(Topic.UNVERIFIED, Topic.BREAKTHROUGH, Topic.SCANNED),
    )
)
# Topics of the whole case: their questions name no trajectory.
OF_THE_CASE = frozenset(
    (
        *(Topic.PATIENT, Topic.RESUME, Topic.HEAD_CLAMPED, Topic.SCANNED, Topic.CART_PLACE),
        *(Topic.CART_LOCKED, Topic.SPHERE_COUNT, Topic.TOOL_CHANGE, Topic.PAUSE, Topic.GUARD),
    )
)
# Topics that no file answers on real devices, including manual work on the patient.
FOR_A_PERSON = DELIBERATE | {Topic.DEPTH_STOP, Topic.SKIN, Topic.DRILL, Topic.DURA}


class Evidence(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Table of evidence for a question, as displayed text with units."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


class PredictedError(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Predicted error at a target, against the margin that the plan allows there.

    `limit_mm` includes the widening; `rms_mm` is as the errors were stated.
    """

    target: str
    rms_mm: float
    limit_mm: float
    confidence: float
    margin_mm: float
    widening: float = 1.0  # factor by which the spheres disagree beyond what the errors stated

    @property
    def verdict(self) -> MarginVerdict:
        """Whether the plan accepts it."""
        return judge_error(self.margin_mm, self.rms_mm, self.limit_mm)

    @property
    def sentence(self) -> str:
        """The verdict, with the limit of the error spelled out."""
        limit = f"{self.limit_mm:.2f} mm"
        if self.verdict is MarginVerdict.LIMIT_BEYOND:
            beyond = f"rms within the margin, but its {self.confidence:.0%} limit, {limit}, is beyond it"
            return beyond + self.caution
        within = "within" if self.verdict is MarginVerdict.PREDICTED_WITHIN else "BEYOND"
        return f"{within} the margin; {self.confidence:.0%} of such errors stay within {limit}{self.caution}"

    @property
    def remark(self) -> str:
        """Remark on the limit, to follow it in a sentence: beyond the margin, widened; empty if neither."""
        beyond = f", {LIMIT_BEYOND_MARGIN}" if self.limit_mm > self.margin_mm else ""
        return beyond + self.caution

    @property
    def caution(self) -> str:
        """Reason for a widened limit, to follow it in a sentence; empty if it is as stated."""
        if self.widening == 1.0:
            return ""
        return f", widened: the spheres disagree {self.widening:.2f} times as much as the errors stated"


class Picture(BaseModel, frozen=True, extra="forbid"):
    """Picture shown with a question: its name among the run's pictures, and its SHA-256."""

    name: str
    sha256: str
    trajectory: str = ""  # whose cuts it shows


class Identity(BaseModel, frozen=True, extra="forbid"):
    """Identity of the patient, shown with a question and stored nowhere.

    Its digest is salted, because a record that has the digest must not confirm a guessed identity.
    """

    rows: tuple[tuple[str, str], ...] = Field(repr=False)  # name and value
    salt: str = Field(default_factory=lambda: secrets.token_hex(16), repr=False)

    @property
    def sha256(self) -> str:
        """SHA-256 (hex) of salt and rows."""
        content = json.dumps([self.salt, self.rows], ensure_ascii=False)
        return hashlib.sha256(content.encode()).hexdigest()


YES, NO = "yes", "no"
READ, NOBODY = "read", "nobody"  # to a question for readings
HELP = "help"  # in place of any answer: what can be typed
MOST_MISREAD = 3  # wrong values at one question that count as no answer
MISREAD_REASON = f"{MOST_MISREAD} wrong values were typed, which counts as no answer"


@dataclass(frozen=True)
class ReadBack:
    """Value to be typed after the first answer, as proof that it was read.

    `what` asks for it, such as `how many mm it moves`. `value` may be the patient's: no record has it.
    `wrong` follows another value that was typed; `shown` is its text in the question, if it is there. The
    `unit` may be typed with it. With `exact`, case counts, as it may tell two patients apart.
    """

    what: str
    value: str = field(repr=False)
    wrong: str = "is not the value to be read back"
    shown: str = ""
    unit: str = ""
    exact: bool = False

    def fits(self, typed: str) -> bool:
        """Return whether the typed text matches the value, ignoring surrounding whitespace."""
        if self.exact:
            return typed.strip() == self.value.strip()
        return strip_unit(typed, self.unit).casefold() == self.value.strip().casefold()


@dataclass(frozen=True)
class Signature:
    """Signature of an answer from the console: the person's name and the digest of the question shown."""

    by: str
    session: str
    shown: str


@dataclass(frozen=True)
class Answer:
    """Answer to a question: the chosen answer and accompanying data."""

    word: str
    typed: str | None = None  # what was read back
    readings: tuple[float, ...] | None = None  # what was read off
    signature: Signature | None = None  # of a named person
    silence_reason: str = ""  # why this is the answer that counts for none


@dataclass(frozen=True)
class Question:
    """Question to the operator. The first of `answers` continues; the last is assumed on timeout.

    `timeout_s` is host time; None waits until someone answers. The operator calls `misread` each time a wrong
    value was read back. `number` counts the questions of a run. `evidence`, `predicted` errors, `pictures`
    and the patient's `identity` are shown with the value, which has one statement on each line. With `reads`,
    the answer that goes on comes with that many readings, each within `plausible_mm`.
    """

    topic: Topic
    subject: str
    value: str
    answers: tuple[str, ...] = (YES, NO)
    trajectory: str | None = None
    timeout_s: float | None = 300.0
    read_back: ReadBack | None = None
    misread: Callable[[], None] = field(default=lambda: None, compare=False, repr=False)
    number: int = 0
    evidence: tuple[Evidence, ...] = ()
    predicted: tuple[PredictedError, ...] = ()  # first what is decided on
    pictures: tuple[Picture, ...] = ()
    identity: Identity | None = field(default=None, repr=False)
    reads: tuple[str, ...] = ()
    plausible_mm: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """Stable name for use in answer files: the topic and any trajectory."""
        return f"{self.topic}:{self.trajectory}" if self.trajectory else str(self.topic)

    @property
    def value_line(self) -> str:
        """Value on one line, for a message."""
        return "; ".join(self.value.splitlines())

    @property
    def deliberate(self) -> bool:
        """Whether continuing moves the arm or accepts a result, and so must not be possible by accident."""
        return self.topic in DELIBERATE

    @property
    def silence(self) -> str:
        """Answer assumed on timeout."""
        return self.answers[-1]

    def is_misread(self, answer: Answer) -> bool:
        """Whether a continuing answer came with a wrong read-back value."""
        typed = answer.typed if answer.word == self.answers[0] else None
        return self.read_back is not None and bool(typed) and not self.read_back.fits(typed or "")

    @staticmethod
    def asks_for_help(answer: Answer) -> bool:
        """Whether `help` was typed as the value to be read back: no try, and no value either."""
        return answer.typed is not None and pick_answer(answer.typed, (HELP,)) is not None

    def why_refused(self, answer: Answer) -> str:
        """Return why an answer is refused, or an empty string if it is valid."""
        if answer.word not in self.answers:
            return f"{answer.word!r} is not an answer"
        if answer.word != self.answers[0]:
            return ""
        if self.read_back is not None and not answer.typed:
            return f"type {self.read_back.what}"
        if self.read_back is not None and self.is_misread(answer):
            return f"what was typed {self.read_back.wrong}"
        if self.reads and (answer.readings is None or len(answer.readings) != len(self.reads)):
            return f"type {', '.join(self.reads)}"
        wrong = [why for one in answer.readings or () if (why := misread(one, self.plausible_mm))]
        return "; ".join(wrong)


def tries_left(misread: int) -> str:
    """Describe how many values may still be typed after `misread` wrong ones."""
    left = MOST_MISREAD - misread
    return f"{left} {'try' if left == 1 else 'tries'} left"


class Operator(Protocol):
    """Operator interface: the person or script that decides."""

    def ask(self, question: Question) -> Answer:
        """Return the answer to a question, or its last answer on timeout."""
        ...


def pick_answer(typed: str, answers: Sequence[str]) -> str | None:
    """Return the answer that was typed, or None: in full, in upper or lower case, with or without quotes."""
    word = " ".join(typed.split()).strip("'").casefold()
    return next((answer for answer in answers if answer.casefold() == word), None)


def join_answers(answers: Sequence[str]) -> str:
    """Join answers for display, such as `yes or no`, quoting answers of several words."""
    *others, last = [f"'{answer}'" if " " in answer else answer for answer in answers]
    return f"{', '.join(others)} or {last}" if others else last


@dataclass(frozen=True)
class Task:
    """Task for the room staff, named as in `ronna_hw.wire.room_tasks`, and the readings it yields.

    `numbers` are needed for it; `reads` names each reading, such as `depth stop in mm`, and `plausible_mm` is
    its possible range.
    """

    name: str
    subject: str  # for a person
    trajectory: str | None = None
    numbers: tuple[float, ...] = ()
    reads: tuple[str, ...] = ()
    plausible_mm: tuple[float, float] | None = None


def misread(reading: float, plausible_mm: tuple[float, float] | None) -> str:
    """Return why a reading looks mistyped, or an empty string if it is plausible."""
    low, high = plausible_mm or (-math.inf, math.inf)
    if low <= reading <= high:
        return ""
    in_cm = "; did you type centimetres?" if low <= 10.0 * reading <= high else ""
    return f"{reading:g} is implausible: expected {low:g} to {high:g}{in_cm}"


class Room(Protocol):
    """Interface of the room staff, who change tools, work on the patient and follow the steps."""

    def announce(self, step: str) -> None:
        """Announce the running step, such as `at_target:T1`."""
        ...

    def change_tool(self, number: int, description: str) -> None:
        """Mount another tool. The step then requests confirmation and reads the controller's inputs."""
        ...

    def prepare_stand(self, holds: str) -> None:
        """Place the ball or divot on the calibration stand. The step then requests confirmation."""
        ...

    def work(self, task: Task) -> tuple[float, ...]:
        """Perform the task and return its readings, empty if not done. The step requests confirmation."""
        ...
