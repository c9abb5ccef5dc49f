"""What can happen: facts, of which a reader gets every one, and signals, of which it gets the latest.

A signal is replaced by the next of the same kind about the same thing (`about`): a slow reader misses poses,
never a question or a fault.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

VERSION = 1  # of all kinds together; raised when a field changes its meaning or goes


class _Happening(BaseModel):
    """One thing that happened."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    signal: ClassVar[bool] = False

    @property
    def about(self) -> str:
        """What a signal is about: it replaces the last one of its kind about the same."""
        return ""


class CaseState(_Happening):
    """The case as a whole entered a state of its state chart."""

    kind: Literal["case"] = "case"
    state: str = Field(description="Such as `operation.relocalization`, `paused`, `held`, `finished`.")
    reason: str = Field(default="", description="Why, where there is a reason.")


class StepState(_Happening):
    """A step began, ended, or lost its result to a repetition."""

    kind: Literal["step"] = "step"
    step: str = Field(description="Such as `registration:T1`.")
    state: Literal["begun", "done", "failed", "interrupted", "superseded"]
    summary: str = Field(default="", description="One line for people.")
    record: str | None = Field(default=None, description="Identifier of the result.")


class Progress(_Happening):
    """How far the running step is."""

    signal: ClassVar[bool] = True
    kind: Literal["progress"] = "progress"
    step: str
    share: float = Field(ge=0, le=1)
    text: str


class Questioned(_Happening):
    """A question stands."""

    kind: Literal["question"] = "question"
    question: int = Field(description="Number of the question in this run.")
    topic: str = Field(description="Stable name of what is decided, such as `approach:T1`.")
    subject: str
    value: str = Field(description="What is being confirmed, with its numbers.")
    answers: tuple[str, ...] = Field(description="The words that answer it; silence means the last one.")
    timeout_s: float | None = Field(description="Host time until silence answers; none: it waits.")


class Answered(_Happening):
    """A question was answered."""

    kind: Literal["answer"] = "answer"
    question: int
    answer: str


class DeviceState(_Happening):
    """State and latched fault of a device. Not a signal: no change of it is lost."""

    kind: Literal["device"] = "device"
    device: str
    state: str
    fault: str | None = Field(default=None, description="The latched error.")


class DeviceAge(_Happening):
    """Age of a device's newest reading."""

    signal: ClassVar[bool] = True
    kind: Literal["age"] = "age"
    device: str
    age_s: float = Field(description="Theatre time.")

    @property
    def about(self) -> str:
        return self.device


class Pose(_Happening):
    """Where an arm stands, at a bounded rate."""

    signal: ClassVar[bool] = True
    kind: Literal["pose"] = "pose"
    arm: str
    joints_rad: tuple[float, ...] = Field(description="Measured joints.")
    age_s: float = Field(description="Theatre time since they were measured.")

    @property
    def about(self) -> str:
        return self.arm


class Finding(_Happening):
    """Something the operator should know that stops nothing."""

    kind: Literal["finding"] = "finding"
    text: str


class Refusal(_Happening):
    """A step may not begin."""

    kind: Literal["refusal"] = "refusal"
    step: str
    unmet: tuple[str, ...]


class Fault(_Happening):
    """An error, as it was shown."""

    kind: Literal["fault"] = "fault"
    code: str
    what: str
    advice: str = ""


class JournalLine(_Happening):
    """A line of the journal, as it was written."""

    kind: Literal["journal"] = "journal"
    line: dict[str, JsonValue]


Happening = Annotated[
    CaseState
    | StepState
    | Progress
    | Questioned
    | Answered
    | DeviceState
    | DeviceAge
    | Pose
    | Finding
    | Refusal
    | Fault
    | JournalLine,
    Field(discriminator="kind"),
]
