"""RSI context: telegram content, channel wiring, and the controller's limits.

`load_context()` reads our own description, `OWN_CONTEXT`; `load_context(path)` another one in the same form.
The driver, the generator of the controller's files and the controller's stand-in all start from the
`RsiContext` it returns. `context_hash()` is what the controller reports as `CtxHash`.

Nothing is encoded or decoded here: each side of the wire does its own.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ronna_hw.arm.catalogue import KUKA
from ronna_hw.arm.name_field import arm_of
from ronna_hw.bounded_input import read_toml
from ronna_hw.errors import ConfigurationError, ErrorCode
from ronna_hw.mistakes import count_mistakes, find_other_kind

DEFAULT_CONTEXT_FILE = "kuka_rsi_context.toml"
OWN_CONTEXT = Path(__file__).with_name(DEFAULT_CONTEXT_FILE)
CHANNELS = 64  # inputs and outputs of one ETHERNET object
AXES = 6
HASH_DIGITS = 16  # of the sha256 in hex: short enough for a KRL string, long enough not to collide

SOFTWARE_END_SWITCHES = "software_end_switches"
INTERNAL: Literal["INTERNAL"] = "INTERNAL"
FREE_TAG = "FREE"  # reserves a channel and is not on the wire

# Defaults of RSI 4.1 objects, in force when a context does not set them.
ETHERNET_DEFAULT_TIMEOUT_PACKETS = 10
ETHERNET_DEFAULT_PRECISION = 1
AXISCORR_DEFAULT_LIMIT_DEG = 5.0
AXISCORRMON_DEFAULT_MAX_DEG = 6.0
POSCORR_DEFAULT_LIMIT_MM = 5.0
POSCORR_DEFAULT_MAX_ROTATION_DEG = 5.0
POSCORRMON_DEFAULT_MAX_TRANSLATION_MM = 6.0
POSCORRMON_DEFAULT_MAX_ROTATION_DEG = 6.0

Channel = Annotated[int, Field(ge=1, le=CHANNELS)]
ElementType = Literal["BOOL", "STRING", "LONG", "DOUBLE"]
SixDegrees = Annotated[tuple[float, ...], Field(min_length=AXES, max_length=AXES)]


CONTEXT_INVALID = ErrorCode(
    "WIR-001",
    ConfigurationError,
    "An RSI context file is malformed.",
    "Correct the listed entries; compare with ronna_hw/wire/kuka_rsi_context.toml.",
)


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class SendElement(_Table):
    """ELEMENT sent by the controller; `indx` is a channel, or "INTERNAL" for a DEF_ keyword."""

    tag: Annotated[str, Field(min_length=1)]
    type: ElementType
    indx: Channel | Literal["INTERNAL"] = INTERNAL


class ReceiveElement(_Table):
    """ELEMENT received by the controller; `holdon` 1 keeps the last value if a reply is missing."""

    tag: Annotated[str, Field(min_length=1)]
    type: ElementType
    indx: Channel | Literal["INTERNAL"]
    holdon: Literal[0, 1]


class Wire(_Table):
    """Wiring of output `indx` of the ETHERNET object to `input` of `object`."""

    indx: Channel
    object: Literal["AXISCORR", "POSCORR", "STOP", "MAP2DIGOUT"]
    input: Literal["A1", "A2", "A3", "A4", "A5", "A6", "X", "Y", "Z", "A", "B", "C", "In1"]


class Feedback(_Table):
    """Wiring of output `Stat` of `object` to input `indx` of the ETHERNET object, for sending."""

    indx: Channel
    object: Literal["AXISCORR", "POSCORR"]
    output: Literal["Stat"] = "Stat"


class Program(_Table):
    """RSI_ON parameters in the KRL program, and the program's target arm."""

    cycle_ms: Literal[4, 12]
    corrections: Literal["absolute", "relative"]
    variant: Annotated[str, arm_of(KUKA)]


class Ethernet(_Table):
    """CONFIG block of the Ethernet file and parameters of the ETHERNET object."""

    pc_ip: str
    pc_port: Annotated[int, Field(ge=1, le=65535)]
    sentype: Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9_]+$")]
    only_send: bool = False
    timeout_packets: Annotated[int, Field(ge=1)] = ETHERNET_DEFAULT_TIMEOUT_PACKETS
    flag: Annotated[int, Field(ge=-1, le=999)] = -1
    precision: Annotated[int, Field(ge=1, le=32)] = ETHERNET_DEFAULT_PRECISION


class AxisCorrection(_Table):
    """Limits of AXISCORR in deg, relative to the pose at RSI_ON: explicit, or up to the end switches."""

    limits: Literal["explicit", "software_end_switches"] = "explicit"
    lower_deg: SixDegrees = (-AXISCORR_DEFAULT_LIMIT_DEG,) * AXES
    upper_deg: SixDegrees = (AXISCORR_DEFAULT_LIMIT_DEG,) * AXES


class AxisMonitor(_Table):
    """Limit of AXISCORRMON: largest total correction in deg, beyond which RSI stops with an error."""

    limits: Literal["explicit", "software_end_switches"] = "explicit"
    max_deg: SixDegrees = (AXISCORRMON_DEFAULT_MAX_DEG,) * AXES


class PositionCorrection(_Table):
    """Limits of POSCORR relative to the pose at RSI_ON, mm and deg."""

    lower_mm: tuple[float, float, float] = (-POSCORR_DEFAULT_LIMIT_MM,) * 3
    upper_mm: tuple[float, float, float] = (POSCORR_DEFAULT_LIMIT_MM,) * 3
    max_rotation_deg: float = POSCORR_DEFAULT_MAX_ROTATION_DEG
    reference: Literal["World", "Base", "RobRoot", "Tool", "TTS"] = "Base"


class PositionMonitor(_Table):
    """Limits of POSCORRMON: largest total translation in mm and rotation in deg."""

    max_translation_mm: float = POSCORRMON_DEFAULT_MAX_TRANSLATION_MM
    max_rotation_deg: float = POSCORRMON_DEFAULT_MAX_ROTATION_DEG


class Stop(_Table):
    """STOP object, triggered by the rising edge of its input."""

    mode: Literal["InfoMessage", "PathNormal", "Velocity", "PathFast", "ExitMoveCorr"] = "ExitMoveCorr"


class RsiContext(_Table):
    """Complete RSI context. Objects set to `None` are absent, and their defaults apply.

    `optional_send` follows `send` in the telegrams of a controller whose Ethernet file has it, and
    `force_send` follows both where a force sensor on the flange is wired to the controller.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,18}$")]
    program: Program
    ethernet: Ethernet
    send: tuple[SendElement, ...]
    optional_send: tuple[SendElement, ...] = ()
    force_send: tuple[SendElement, ...] = ()
    receive: tuple[ReceiveElement, ...]
    wiring: tuple[Wire, ...]
    feedback: tuple[Feedback, ...] = ()
    axis_correction: AxisCorrection | None = None
    axis_monitor: AxisMonitor | None = None
    position_correction: PositionCorrection | None = None
    position_monitor: PositionMonitor | None = None
    stop: Stop | None = None

    @property
    def all_send(self) -> tuple[SendElement, ...]:
        """All that a controller may send, in the order of its telegrams."""
        return self.send + self.optional_send

    def with_force_sensor(self) -> RsiContext:
        """Return the context of a controller to which a force sensor is wired."""
        both = self.optional_send + self.force_send
        return self.model_copy(update={"optional_send": both, "force_send": ()})

    @model_validator(mode="after")
    def _channels_agree(self) -> Self:
        channels = [e.indx for e in self.receive if e.indx != INTERNAL]
        if len(set(channels)) != len(channels):
            raise ValueError("receive: each indx may be used once")
        if missing := sorted({w.indx for w in self.wiring} - set(channels)):
            raise ValueError(f"wiring: indx {missing} is not received")
        inputs = [(w.object, w.input) for w in self.wiring]
        if len(set(inputs)) != len(inputs):
            raise ValueError("wiring: each object input may be fed once")
        every_send = self.all_send + self.force_send
        sent = [e.indx for e in every_send if e.indx != INTERNAL]
        if unsent := sorted({f.indx for f in self.feedback} - set(sent)):
            raise ValueError(f"feedback: indx {unsent} is not sent")
        for element in every_send:
            if (element.indx == INTERNAL) != element.tag.startswith("DEF_"):
                raise ValueError(f"send: {element.tag}: a tag is INTERNAL if and only if it begins with DEF_")
        return self

    def find_wired_tag(self, object_name: str, input_name: str) -> str | None:
        """Find the tag of the received element that feeds an object input, or return None if unwired."""
        for wire in self.wiring:
            if (wire.object, wire.input) == (object_name, input_name):
                return next(e.tag for e in self.receive if e.indx == wire.indx)
        return None


def load_context(path: Path | None = None) -> RsiContext:
    """Read a context, by default the project's own. Raises WIR-001 listing every mistake in one line."""
    source = str(path) if path else DEFAULT_CONTEXT_FILE
    try:
        content = read_toml(path or OWN_CONTEXT, CONTEXT_INVALID)
        if kind := find_other_kind(content, "wiring"):
            raise CONTEXT_INVALID(f"{source} is {kind}, not an RSI context", expected="a table [[wiring]]")
        # JSON in between: in strict mode pydantic accepts arrays as tuples from JSON only.
        return RsiContext.model_validate_json(json.dumps(content, default=str))
    except OSError as error:
        raise CONTEXT_INVALID(f"cannot read the RSI context {source}: {error.strerror}") from error
    except ValidationError as error:
        raise CONTEXT_INVALID(f"the RSI context {source} has {count_mistakes(error, RsiContext)}") from None


def context_hash(context: RsiContext) -> str:
    """Return a shortened SHA-256 of the canonical description.

    The PC's address and optional signals do not count: no client depends on them. Canonical is JSON with
    sorted keys and no blanks, defaults written out, except for an unwired feedback: two files with the same
    meaning have the same hash.
    """
    plain_model = context.model_dump(mode="json", by_alias=True)
    del plain_model["ethernet"]["pc_ip"], plain_model["ethernet"]["pc_port"]
    del plain_model["optional_send"], plain_model["force_send"]
    if not context.feedback:
        del plain_model["feedback"]
    canonical = json.dumps(plain_model, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(canonical.encode("ascii")).hexdigest()[:HASH_DIGITS]
