"""Operator orders, shared by prompt, script and console page. `RULES` defines when each is accepted.

A session of the console sends an order with the state that it saw. If that is out of date, nothing is done;
only a stop needs no state. Each order sent has its own nonce and is carried out once.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum, auto
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from procedures.operator.checkpoint import ABORT, CONTINUE
from procedures.operator.question import Topic
from ronna_hw.bounded_input import check_json
from ronna_hw.devices.errors import PersonNotNamed
from ronna_hw.devices.lifecycle import require_person

LONGEST_BYTES = 65_536  # of one order
MOST_READINGS = 8  # with one answer
Short = Annotated[str, Field(max_length=200)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Nonce = Annotated[str, Field(min_length=8, max_length=64, pattern=r"^[0-9A-Za-z_-]+$")]
Name = Annotated[str, AfterValidator(require_person)]


class Order(BaseModel):
    """Base class of all orders."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Claim(Order):
    """Take the free seat under a name."""

    kind: Literal["claim"] = "claim"
    name: Name


class Renew(Order):
    """Renew the seat's lease."""

    kind: Literal["renew"] = "renew"


class Release(Order):
    """Leave the seat."""

    kind: Literal["release"] = "release"


class Next(Order):
    """Run the next step."""

    kind: Literal["next"] = "next"


class Run(Order):
    """Run a step that can start, or repeat a completed one."""

    step: str


class RunTo(Order):
    """Run the steps up to and including a given step."""

    kind: Literal["run_to"] = "run_to"
    step: Short


class Repeat(Order):
    """Repeat a completed step."""

    step: str


class Home(Order):
    """Bring the arm home."""


class Pause(Order):
    """Pause at the next safe point."""

    kind: Literal["pause"] = "pause"


class Resume(Order):
    """Run to the end of the case. At a prompt, also continue a paused case.

    A page ends a pause by the answer to its question instead.
    """

    kind: Literal["resume"] = "resume"


class Stop(Order):
    """Stop the arm as fast as the link allows, then pause."""

    kind: Literal["stop"] = "stop"


class Abort(Order):
    """Retreat, park, and end the case."""

    kind: Literal["abort"] = "abort"


class Acknowledge(Order):
    """Recover devices in fault under the sender's name. Nothing moves."""

    kind: Literal["acknowledge"] = "acknowledge"


class AnswerQuestion(Order):
    """Answer the open question."""

    kind: Literal["answer"] = "answer"
    question: int
    answer: Short
    shown: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] = Field(
        description="Digest of what the operator was shown."
    )
    typed: Short | None = Field(default=None, description="What was read back.")
    readings: Annotated[tuple[Finite, ...], Field(max_length=MOST_READINGS, strict=False)] | None = Field(
        default=None, description="What was read off."
    )


class ListSteps(Order):
    """Show every step and its status."""


class Why(Order):
    """Explain why a step (by default the next) cannot start, and list its questions."""

    step: str | None = None


class DryRun(Order):
    """Preview the motions of a step (by default the next)."""

    step: str | None = None


class Help(Order):
    """List the commands."""


class Quit(Order):
    """Leave the case as it is."""


class CaseActivity(Enum):
    """Activity of a case at the moment an order arrives."""

    OPENING = auto()  # the theatre is not open yet
    WAITING = auto()  # between steps
    RUNNING = auto()
    ASKING = auto()  # a question is open
    PAUSED = auto()  # the question of a pause is open


OPENING, WAITING, RUNNING, ASKING, PAUSED = CaseActivity
OPEN = frozenset({WAITING, RUNNING, ASKING, PAUSED})
ANY = OPEN | {OPENING}
AT_REST = frozenset({WAITING, PAUSED})
NEVER: frozenset[CaseActivity] = frozenset()


def activity_of(topic: str | None, *, is_waiting: bool) -> CaseActivity:
    """Return the activity of an open theatre with an open question of this topic, or waiting for an order."""
    if topic is not None:
        return PAUSED if topic == Topic.PAUSE else ASKING
    return WAITING if is_waiting else RUNNING


@dataclass(frozen=True)
class Rule:
    """Command for an order, and the activities during which prompt and console accept it.

    From the console it needs the operator's seat, unless `seat` says otherwise. An argument in brackets may
    be omitted.
    """

    order: type[Order]
    at_prompt: Collection[CaseActivity]
    from_console: Collection[CaseActivity]
    command: str = ""
    argument: str = ""
    does: str = ""
    seat: bool = True


RULES = (
    Rule(Claim, NEVER, ANY, seat=False),
    Rule(Renew, NEVER, ANY, seat=False),
    Rule(Release, NEVER, ANY),
    Rule(AnswerQuestion, NEVER, OPEN),  # a question that is not open is refused as such
    Rule(ListSteps, AT_REST, NEVER, "list", "", "every step and its status"),
    Rule(Next, {WAITING}, {WAITING}, "next", "", "run the next step"),
    Rule(Run, {WAITING}, NEVER, "run", "STEP", "run a step that can start"),
    Rule(RunTo, {WAITING}, {WAITING}, "to", "STEP", "run up to and including a step"),
    Rule(Repeat, {WAITING}, NEVER, "back", "STEP", "repeat a step; shows what that supersedes"),
    Rule(Why, AT_REST, NEVER, "why", "[STEP]", "why a step cannot start now, and what it asks"),
    Rule(DryRun, AT_REST, NEVER, "dry", "[STEP]", "the motions of a step; nothing moves"),
    Rule(Pause, {WAITING}, OPEN - {WAITING}, "pause", "", "pause before the next step"),
    Rule(
        Stop,
        {WAITING, RUNNING},  # the latter from a script, in which it overtakes other lines
        ANY,
        "stop",
        "",
        "stop the arm and pause, from a script while a step runs; typed, Ctrl-C twice",
        seat=False,
    ),
    Rule(Resume, AT_REST, {WAITING}, "resume", "", "continue a paused case"),
    Rule(
        Home,
        {WAITING},
        NEVER,
        "home",
        "",
        "instrument out, guide back, then park; not while a step is paused",
    ),
    Rule(
        Acknowledge,
        AT_REST,
        AT_REST,
        "acknowledge",
        "YOUR-NAME",
        "recover devices in fault; a paused step begins again",
    ),
    Rule(Abort, AT_REST, OPEN, "abort", "", "home, then end the case"),
    Rule(Help, AT_REST, NEVER, "help", "", "this list"),
    Rule(Quit, {WAITING}, NEVER, "quit", "", "leave the case; not possible while an instrument is inside"),
)
RULE_OF = {rule.order: rule for rule in RULES}
COMMANDS = {rule.command: rule for rule in RULES if rule.command}
PAUSE_ANSWERS = {Resume: CONTINUE, Abort: ABORT}  # orders that answer the question of a pause at a prompt
QUOTING_NEXT = (Next, RunTo, Resume)  # sent with the step that was shown as next
ConsoleOrder = (
    Claim | Renew | Release | Next | RunTo | Pause | Resume | Stop | Abort | Acknowledge | AnswerQuestion
)


class SentOrder(BaseModel, frozen=True, extra="forbid", strict=True):
    """An order as sent by a session. In JSON, its fields are flattened into this object."""

    nonce: Nonce
    expires_s: Finite | None = Field(default=None, description="Monotonic host time; too late after it.")
    session: Annotated[str, Field(min_length=8, max_length=64)]
    upcoming: Short | None = Field(default=None, description="The step that was shown as next.")
    order: Annotated[ConsoleOrder, Field(discriminator="kind")]

    @model_validator(mode="before")
    @classmethod
    def _gather_order(cls, given: Any) -> Any:
        if not isinstance(given, dict) or isinstance(given.get("order"), Order):
            return given
        own = {name: value for name, value in given.items() if name in cls.model_fields and name != "order"}
        return own | {"order": {name: value for name, value in given.items() if name not in own}}

    @model_validator(mode="after")
    def _require_upcoming(self) -> Self:
        if isinstance(self.order, QUOTING_NEXT) != (self.upcoming is not None):
            raise ValueError("only orders that begin steps quote the step shown as next, and must")
        return self

    @model_serializer(mode="wrap")
    def _flatten_order(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields = plain(self)
        return {**fields.pop("order"), **fields}


def read_order(line: bytes | str) -> SentOrder:
    """Parse an order from JSON. Raises ValueError if it is invalid or too long."""
    content = line.encode() if isinstance(line, str) else line
    if len(content) > LONGEST_BYTES:
        raise ValueError(f"an order of {len(content)} bytes")
    return SentOrder.model_validate_json(check_json(content))


def explain_invalid_order(order: dict[str, Any]) -> str:
    """Return why `read_order` does not accept an order of a page."""
    if order["kind"] == "claim":
        try:
            require_person(order["name"])
        except PersonNotNamed as problem:
            return problem.summary
    return "not a valid order"


class OrderReply(BaseModel, frozen=True, extra="forbid"):
    """Reply to an order."""

    nonce: str
    refused: str = ""  # why; empty: it is being carried out
