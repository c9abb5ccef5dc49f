"""Event types: facts, all delivered to every reader, and signals, only the latest value delivered.

A signal is replaced by the next of the same kind about the same thing (`about`): a slow reader misses poses,
never a question or a fault.
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, JsonValue, model_validator

from procedures.operator.question import Evidence, Identity, Picture, PredictedError

VERSION = 1  # of all kinds together; raised when a field changes its meaning or goes
MOST_STEPS = 800  # seven for each of a plan's trajectories, of which there are at most a hundred

Count = Annotated[int, Field(ge=0, lt=2**63)]  # of which a rate is computed: a longer one is no number there

Ends = Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]
MOST_PLACES = 1_000  # of the skin: all of them are sent after each look
Places = Annotated[tuple[tuple[float, float, float], ...], Field(max_length=MOST_PLACES)]


class _Plain(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _EventBase(_Plain):
    """Base class of all event contents."""

    signal: ClassVar[bool] = False

    @property
    def about(self) -> str:
        """Subject of a signal; a new signal replaces the previous one of its kind on the same subject."""
        return ""


class CaseState(_EventBase):
    """The case entered a new state of the state chart."""

    kind: Literal["case"] = "case"
    state: str = Field(description="For example `operation.relocalization`, `paused`, `held`, `finished`.")
    reason: str = Field(default="", description="The reason, if there is one.")


class StepState(_EventBase):
    """A step began or ended, or its result was superseded."""

    kind: Literal["step"] = "step"
    step: str = Field(description="Such as `registration:T1`.")
    title: str = Field(default="", description="What it does, of a step that begins, is done or fails.")
    state: Literal["begun", "done", "failed", "interrupted", "superseded"]
    summary: str = Field(default="", description="One line for the operator.")
    record: str | None = Field(default=None, description="Identifier of the result.")


class ExpectedError(_Plain):
    """Error to expect at a target as the scan of the skin grows, without arm and guide."""

    target: str
    rms_mm: tuple[Annotated[float, Field(ge=0)] | None, ...] = Field(
        description="After each look taken, in their order; none: it was too little."
    )


class ScanProgress(_Plain):
    """State of a scan of the skin, as it grows or at its end."""

    looks_done: Count = Field(description="Looks taken, with those kept from before an interruption.")
    looks_planned: Count
    covered_share: float = Field(ge=0, le=1, description="Of the skin that is planned to be scanned.")
    predicted_error_mm: float | None = Field(
        description="Expected rms error at the targets with what is scanned so far; none: it is too little."
    )
    expected: tuple[ExpectedError, ...] = Field(default=(), description="The same, target by target.")
    covered_mm: Places = Field(default=(), description="Places of the planned skin that are covered, CT.")
    missing_mm: Places = Field(default=(), description="Those that are not, CT.")


class Progress(_EventBase):
    """Progress of the running step."""

    signal: ClassVar[bool] = True
    kind: Literal["progress"] = "progress"
    step: str
    share: float = Field(ge=0, le=1)
    text: str
    scan: ScanProgress | None = Field(default=None, description="Of a scan of the skin.")


class Questioned(_EventBase):
    """A question was put to the operator."""

    kind: Literal["question"] = "question"
    question: int = Field(description="Number of the question in this run.")
    topic: str = Field(description="Stable name of the decision, such as `approach:T1`.")
    subject: str
    value: str = Field(description="What is being confirmed, with its numbers.")
    answers: tuple[str, ...] = Field(description="The accepted answers; no answer counts as the last one.")
    timeout_s: float | None = Field(
        description="Host time after which no answer counts as the last one; none: it waits indefinitely."
    )
    evidence: tuple[Evidence, ...] = Field(default=(), description="The evidence for the decision.")
    predicted: tuple[PredictedError, ...] = Field(
        default=(), description="Predicted errors, first the one that is decided on."
    )
    pictures: tuple[Picture, ...] = Field(default=(), description="Pictures of the run that are shown.")
    identity: Identity | None = Field(
        default=None, exclude=True, repr=False, description="Of the patient: shown, and in no file."
    )
    identity_sha256: str = Field(default="", description="Salted SHA-256 of the identity shown.")
    read_back: str | None = Field(default=None, description="What must be typed with the first answer.")
    emphasis: str = Field(default="", description="Part of the value that is to be read back.")
    reads: tuple[str, ...] = Field(
        default=(), description="The readings that must be typed with it, as numbers."
    )
    deliberate: bool = Field(
        default=False, description="Whether the first answer moves the arm or permits it to move."
    )

    def with_identity(self, identity: Identity) -> Questioned:
        """Return the question with the identity that its digest is of."""
        return self.model_copy(update={"identity": identity})


class Answered(_EventBase):
    """A question was answered."""

    kind: Literal["answer"] = "answer"
    question: int
    answer: str
    by: str = Field(default="", description="Who answered at a console; empty: terminal or script.")


class Seat(_EventBase):
    """An operator took or left the console seat."""

    kind: Literal["seat"] = "seat"
    holder: str = Field(description="Name as given; empty: the seat is free.")
    reason: str = Field(default="", description="Why it is free.")


class OrderedStep(_Plain):
    """A step in the order of a case."""

    step: str = Field(description="Such as `registration:T1`.")
    title: str
    phase: str
    moves: bool
    record: str | None = Field(
        default=None,
        description="Identifier of the result that is already valid, because the run was resumed.",
    )
    doubt: str = Field(default="", description="Fault of an arm that came after that result.")


class Order(_EventBase):
    """The case's steps in order."""

    kind: Literal["order"] = "order"
    steps: tuple[OrderedStep, ...] = Field(max_length=MOST_STEPS)


class Waiting(_EventBase):
    """The engine is waiting between steps for the operator."""

    kind: Literal["waiting"] = "waiting"
    upcoming: str | None = Field(description="The step that comes next, or `home`; none: the case is over.")
    unmet: tuple[str, ...] = Field(default=(), description="Why it cannot start.")


class DeviceFact(_Plain):
    """A fact reported by a device, such as its operating mode, and whether it lets the case continue."""

    name: str
    found: str
    ready: bool = True


class DeviceState(_EventBase):
    """State, latched fault and alarms of a device. A fact, not a signal, so that no change is lost."""

    kind: Literal["device"] = "device"
    device: str
    state: str
    fault: str | None = Field(default=None, description="The latched error.")
    says: tuple[DeviceFact, ...] = Field(default=(), description="Its last unsolicited status.")
    notices: tuple[str, ...] = Field(default=(), description="Findings that are not errors.")


class MeasuringVolume(_EventBase):
    """A tracker's measuring volume: rectangles across its axis, from near to far, in its own frame."""

    kind: Literal["volume"] = "volume"
    device: str
    sections_mm: tuple[tuple[float, float, float], ...] = Field(
        description="Position along z, half-extent along x, half-extent along y."
    )


class DeviceAge(_EventBase):
    """Age of a device's newest reading."""

    signal: ClassVar[bool] = True
    kind: Literal["age"] = "age"
    device: str
    age_s: float = Field(description="Theatre time.")
    readings: Count | None = Field(default=None, description="How many there were since it was activated.")
    validity: str = Field(default="", description="Of the reading, such as `ok` or `partial`.")

    @property
    def about(self) -> str:
        return self.device


class Pose(_EventBase):
    """Arm pose, published at a bounded rate."""

    signal: ClassVar[bool] = True
    kind: Literal["pose"] = "pose"
    arm: str
    joints_rad: tuple[float, ...] = Field(description="Measured joints.")
    age_s: float = Field(description="Theatre time since they were measured.")

    @property
    def about(self) -> str:
        return self.arm

    bodies_mm: tuple[Ends, ...] = Field(
        default=(), description="Both ends of the axis of each moving body, in the frame of the robot."
    )
    tool_mm: tuple[float, ...] = Field(
        default=(), description="Origin of the tool, in the frame of the robot; only where it has cameras."
    )
    tool_rows: tuple[float, ...] = Field(default=(), description="Its rotation matrix, row by row.")

    @model_validator(mode="after")
    def _whole_tool(self) -> Self:
        if (len(self.tool_mm), len(self.tool_rows)) not in ((0, 0), (3, 9)):
            raise ValueError("a tool has an origin and a rotation matrix, or neither")
        return self


class Body(_Plain):
    """A capsule in the collision check; the ends of a moving capsule are sent with each pose."""

    name: str
    radius_mm: float
    ends_mm: tuple[float, ...] = Field(default=(), description="Of a fixed one, in the frame of the robot.")
    is_head: bool = False


class CameraView(_Plain):
    """View of one camera of the mounted tool, in the tool frame."""

    name: str
    points_mm: tuple[float, ...] = Field(description="Its centre, then the corners of its picture.")


class Bodies(_EventBase):
    """Bodies in the collision check before and during arm motion."""

    kind: Literal["bodies"] = "bodies"
    arm: str = Field(default="arm", description="Device whose arm moves them.")
    with_guide: bool = Field(default=True, description="Whether this arm carries head and guide.")
    margin_mm: float = Field(default=10.0, description="Clearance of planned paths.")
    moving: tuple[Body, ...] = Field(description="Links, then parts of the tool.")
    links: Count = Field(default=4, description="How many of those are links.")
    fixed: tuple[Body, ...]
    pairs: tuple[tuple[int, int], ...] = Field(
        description="Moving body, and the other one: a fixed one, or -1 - k for the moving body k. "
        "Without the head and what may enter it."
    )
    cameras: tuple[CameraView, ...] = Field(default=(), description="Of the mounted tool.")

    @property
    def about(self) -> str:
        return self.arm

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Self:
        moving, fixed = len(self.moving), len(self.fixed)
        if not all(0 <= first < moving and -moving <= second < fixed for first, second in self.pairs):
            raise ValueError("a pair names a body that is not there")
        if any(len(one.ends_mm) != 6 for one in self.fixed):
            raise ValueError("a fixed body has two ends")
        if any(len(one.points_mm) != 15 for one in self.cameras):
            raise ValueError("a camera has a centre and four corners")
        return self


class ArmsApart(_EventBase):
    """Distance between two arms, published when one has moved."""

    signal: ClassVar[bool] = True
    kind: Literal["arms_apart"] = "arms_apart"
    arms: tuple[str, str] = Field(description="Devices of both arms.")
    bodies: tuple[str, str] = Field(description="The body of each that is closest to the other arm.")
    distance_mm: float

    @property
    def about(self) -> str:
        return " ".join(self.arms)


class LinkHealth(_EventBase):
    """Health of the robot link since the arm was last activated; times in host time."""

    signal: ClassVar[bool] = True
    kind: Literal["link"] = "link"
    cycles: Count
    late: int
    lost: int
    rejected: int
    turnaround_median_us: float
    turnaround_p99_us: float


class Advisory(_EventBase):
    """A finding reported to the operator without stopping the case."""

    kind: Literal["finding"] = "finding"
    text: str


class Refusal(_EventBase):
    """A step was refused."""

    kind: Literal["refusal"] = "refusal"
    step: str
    unmet: tuple[str, ...]


class Fault(_EventBase):
    """An error as shown to the operator."""

    kind: Literal["fault"] = "fault"
    code: str
    what: str
    advice: str = ""


class SignalsLost(_EventBase):
    """Some signals are missing from the event file. Facts are never lost."""

    kind: Literal["signals_lost"] = "signals_lost"
    count: int = Field(ge=1, description="Signals of this program so far that the file does not hold.")


class JournalLine(_EventBase):
    """A journal line as written."""

    kind: Literal["journal"] = "journal"
    line: dict[str, JsonValue]


EventContent = Annotated[
    CaseState
    | StepState
    | Progress
    | Questioned
    | Answered
    | Seat
    | Order
    | Waiting
    | DeviceState
    | DeviceAge
    | MeasuringVolume
    | Pose
    | Bodies
    | ArmsApart
    | LinkHealth
    | Advisory
    | Refusal
    | Fault
    | SignalsLost
    | JournalLine,
    Field(discriminator="kind"),
]


class Event(_Plain):
    """A numbered, timed event as delivered to readers and stored in the run's event file."""

    version: int = VERSION
    number: int = Field(description="Counts all events of a run from 1.")
    host_time: AwareDatetime
    theatre_time_s: float
    what: EventContent

    @property
    def subject(self) -> str:
        """Key of a signal, from its kind and subject; only the latest signal per key matters."""
        return f"{self.what.kind} {self.what.about}"


SIGNED = {
    *("question", "topic", "subject", "value", "answers", "evidence", "predicted", "pictures"),
    *("identity_sha256", "read_back", "emphasis", "reads"),
}


def digest_of_question(question: Questioned) -> str:
    """Return the SHA-256 (hex) of everything in a question that can influence the answer.

    An answer quotes it, so that nobody confirms what was not shown.
    """
    content = question.model_dump(mode="json", include=SIGNED)
    return hashlib.sha256(json.dumps(content, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
