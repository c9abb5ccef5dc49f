"""Orders of an operator to a running case: one vocabulary for a page's buttons, a script and a test.

An order names its session and what that session saw. If that is out of date, nothing is done; only a stop
needs nothing. Each order has a nonce of its own and is carried out once.
"""

from __future__ import annotations

from typing import Annotated, Literal
from unicodedata import category

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter

from ronna_hw.bounded_input import check_json

LONGEST_BYTES = 65_536  # of one order
MOST_READINGS = 8  # with one answer
Short = Annotated[str, Field(max_length=200)]
HIDDEN = ("Cc", "Cf", "Cs", "Zl", "Zp")  # categories of Unicode
JOINERS = "\u200c\u200d"  # parts of names in some scripts
Finite = Annotated[float, Field(allow_inf_nan=False)]
Nonce = Annotated[str, Field(min_length=8, max_length=64, pattern=r"^[0-9A-Za-z_-]+$")]


def _shown_as_written(name: str) -> str:
    """Refuse control and format characters: they can make a name read as another person's."""
    if any(category(letter) in HIDDEN for letter in name if letter not in JOINERS):
        raise ValueError("a name has only characters that are shown")
    return name


Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"\S"), AfterValidator(_shown_as_written)]


class _Order(BaseModel):
    """Base of all orders."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    nonce: Nonce
    expires_s: Finite | None = Field(default=None, description="Monotonic host time; too late after it.")
    session: Annotated[str, Field(min_length=8, max_length=64)]


class Claim(_Order):
    """Take the free seat under a name."""

    kind: Literal["claim"] = "claim"
    name: Name


class Renew(_Order):
    """Stay in the seat."""

    kind: Literal["renew"] = "renew"


class Release(_Order):
    """Leave the seat."""

    kind: Literal["release"] = "release"


class Next(_Order):
    """Run the next step."""

    kind: Literal["next"] = "next"
    upcoming: Short = Field(description="The step that was shown as next.")


class RunTo(_Order):
    """Run the steps up to and including one."""

    kind: Literal["run_to"] = "run_to"
    upcoming: Short = Field(description="The step that was shown as next.")
    step: Short


class Pause(_Order):
    """Rest at the next safe point."""

    kind: Literal["pause"] = "pause"


class Resume(_Order):
    """Run to the end of the case. A pause is ended by the answer to its question instead."""

    kind: Literal["resume"] = "resume"
    upcoming: Short = Field(description="The step that was shown as next.")


class Stop(_Order):
    """Bring the arm to rest now, as well as the link allows; then rest."""

    kind: Literal["stop"] = "stop"


class Abort(_Order):
    """Retreat, park, and end the case."""

    kind: Literal["abort"] = "abort"


class Acknowledge(_Order):
    """Recover the devices that are in fault; moves nothing."""

    kind: Literal["acknowledge"] = "acknowledge"


class AnswerQuestion(_Order):
    """Answer the open question."""

    kind: Literal["answer"] = "answer"
    question: int
    answer: Short
    shown: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] = Field(
        description="Digest of what the operator was shown."
    )
    typed: Short | None = Field(default=None, description="What was read back.")
    readings: Annotated[tuple[Finite, ...], Field(max_length=MOST_READINGS)] | None = Field(
        default=None, description="What was read off."
    )


AnyOrder = (
    Claim | Renew | Release | Next | RunTo | Pause | Resume | Stop | Abort | Acknowledge | AnswerQuestion
)
_ORDERS: TypeAdapter[AnyOrder] = TypeAdapter(Annotated[AnyOrder, Field(discriminator="kind")])


def read_order(line: bytes | str) -> AnyOrder:
    """Read an order from JSON. Raises ValueError for anything else."""
    content = line.encode() if isinstance(line, str) else line
    if len(content) > LONGEST_BYTES:
        raise ValueError(f"an order of {len(content)} bytes")
    return _ORDERS.validate_json(check_json(content))


class Reply(BaseModel):
    """The reply to an order."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    nonce: str
    refused: str = ""  # why; empty: it is being carried out
