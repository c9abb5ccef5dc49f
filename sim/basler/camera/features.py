"""The features of a camera: names of the family, limits, and the values behind them.

One table serves both the registers and the XML that describes them, so every register named in the XML
exists. Numbers are 32-bit integers or 32-bit floats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

from sim.basler.camera.acquisition import Acquisition
from sim.basler.camera.settings import Settings
from sim.basler.stream_channel import StreamChannel

Number = int | float


class Commands(Protocol):
    """What features can do or query beyond the settings."""

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
    """Kinds of features, by their GenICam node."""

    INTEGER = "Integer"
    FLOAT = "Float"
    ENUMERATION = "Enumeration"
    BOOLEAN = "Boolean"
    COMMAND = "Command"


Getter = Callable[[Commands], Number]
Setter = Callable[[Commands, Any], None]


@dataclass(frozen=True)
class Feature:
    """One feature with its own register.

    Without `write` it is read-only; a command has only `write`. `locked` features cannot be written during
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


def of_settings(name: str) -> tuple[Getter, Setter]:
    """Getter and setter of an attribute of the settings."""
    return (
        lambda commands: getattr(commands.settings, name),
        lambda commands, value: setattr(commands.settings, name, value),
    )


def of_trigger(name: str) -> tuple[Getter, Setter]:
    """Getter and setter of an attribute of the selected trigger."""
    return (
        lambda commands: getattr(commands.settings.selected_trigger, name),
        lambda commands, value: setattr(commands.settings.selected_trigger, name, value),
    )


def always(value: Number) -> Getter:
    """A constant value."""
    return lambda _commands: value


def setting(name: str, category: str, about: str, attribute: str, **more: Any) -> Feature:
    """A feature backed by an attribute of the settings; an integer unless `kind` is given."""
    read, write = of_settings(attribute)
    kind = more.pop("kind", Kind.INTEGER)
    return Feature(name, kind, category, about, read=read, write=write, **more)


def trigger_setting(name: str, about: str, attribute: str, kind: Kind, **more: Any) -> Feature:
    """A feature backed by an attribute of the selected trigger."""
    read, write = of_trigger(attribute)
    return Feature(name, kind, "AcquisitionTrigger", about, read=read, write=write, **more)


def constant(name: str, category: str, about: str, value: float, **more: Any) -> Feature:
    """A constant feature; an integer unless `kind` is given."""
    kind = more.pop("kind", Kind.INTEGER)
    return Feature(name, kind, category, about, read=always(value), **more)


def only(entry: str) -> dict[str, Any]:
    """An enumeration with a single entry: the family's name, with one choice here."""
    return {"kind": Kind.ENUMERATION, "entries": {entry: 0}, "write": lambda _commands, _value: None}
