"""The features of a camera: names, limits, and the values behind them.

One table serves both the registers and the XML that describes them, so every register named in the XML
exists. Numbers are 32-bit integers or 32-bit floats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

from sim.basler.camera.acquisition import Acquisition
from sim.basler.settings import Settings
from sim.basler.stream_channel import StreamChannel

Number = int | float


class Commands(Protocol):
    """The camera as its features see it."""

    @property
    def settings(self) -> Settings: ...

    @property
    def acquisition(self) -> Acquisition: ...

    @property
    def channel(self) -> StreamChannel: ...

    @property
    def acquiring(self) -> bool: ...

    def load_user_set(self) -> None: ...

    def save_user_set(self) -> None: ...


class Kind(Enum):
    """GenICam node of a feature."""

    INTEGER = "Integer"
    FLOAT = "Float"
    ENUMERATION = "Enumeration"
    BOOLEAN = "Boolean"
    COMMAND = "Command"


Getter = Callable[[Commands], Number]
Setter = Callable[[Commands, Any], None]


@dataclass(frozen=True)
class Feature:
    """A feature with its own register.

    Without `write` it is read-only; a command has only `write`. A `locked` feature cannot be written during
    acquisition. `selects` names the features that depend on this selector.
    """

    name: str
    kind: Kind
    category: str
    about: str
    read: Getter | None = None
    write: Setter | None = None
    minimum: Getter | None = None
    maximum: Getter | None = None
    step: int = 1
    unit: str = ""
    entries: Mapping[str, int] = field(default_factory=dict)
    locked: bool = False
    selects: tuple[str, ...] = ()
    visibility: str = "Beginner"

    def accepts(self, commands: Commands, value: Number) -> bool:
        """Whether a value may be written."""
        if self.kind is Kind.ENUMERATION:
            return value in self.entries.values()
        if self.kind is Kind.BOOLEAN:
            return value in (0, 1)
        if self.kind is Kind.COMMAND:
            return True
        low = self.minimum(commands) if self.minimum else 0
        high = self.maximum(commands) if self.maximum else 0xFFFFFFFF
        # NaN fails every comparison.
        within = low <= value <= high
        return within and (self.kind is Kind.FLOAT or (value - low) % self.step == 0)


def always(value: Number) -> Getter:
    """Return a getter of a constant."""
    return lambda _commands: value


def setting(name: str, category: str, about: str, attribute: str, **more: Any) -> Feature:
    """Define a feature backed by an attribute of the settings; an integer unless `kind` is given."""
    return Feature(
        name,
        more.pop("kind", Kind.INTEGER),
        category,
        about,
        read=lambda commands: getattr(commands.settings, attribute),
        write=lambda commands, value: setattr(commands.settings, attribute, value),
        **more,
    )


def trigger_setting(name: str, about: str, attribute: str, kind: Kind, **more: Any) -> Feature:
    """Define a feature backed by an attribute of the selected trigger."""
    return Feature(
        name,
        kind,
        "AcquisitionTrigger",
        about,
        read=lambda commands: getattr(commands.settings.selected_trigger, attribute),
        write=lambda commands, value: setattr(commands.settings.selected_trigger, attribute, value),
        **more,
    )


def constant(name: str, category: str, about: str, value: float, **more: Any) -> Feature:
    """Define a constant feature; an integer unless `kind` is given."""
    kind = more.pop("kind", Kind.INTEGER)
    return Feature(name, kind, category, about, read=always(value), **more)


def single_entry(entry: str) -> dict[str, Any]:
    """Return the keywords of an enumeration with a single entry: the family's name, one choice here."""
    return {"kind": Kind.ENUMERATION, "entries": {entry: 0}, "write": lambda _commands, _value: None}
