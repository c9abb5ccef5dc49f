"""Camera features: names, limits and backing values.

One table serves both the registers and the XML that describes them, so every register named in the XML
exists. Numbers are 32-bit integers or 32-bit floats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Protocol

from sim.basler.camera.acquisition import Acquisition
from sim.basler.settings import CameraSettings
from sim.basler.stream_channel import StreamChannel

Number = int | float


class FeatureState(Protocol):
    """Camera state that the features read and write."""

    @property
    def settings(self) -> CameraSettings: ...

    @property
    def acquisition(self) -> Acquisition: ...

    @property
    def channel(self) -> StreamChannel: ...

    @property
    def output_held_low(self) -> bool: ...

    def load_user_set(self) -> None: ...

    def save_user_set(self) -> None: ...


class Kind(Enum):
    """GenICam node type of a feature."""

    INTEGER = "Integer"
    FLOAT = "Float"
    ENUMERATION = "Enumeration"
    BOOLEAN = "Boolean"
    COMMAND = "Command"


Getter = Callable[[FeatureState], Number]
Limit = Number | Getter  # a limit may depend on other settings
Setter = Callable[[FeatureState, Any], None]


@dataclass(frozen=True)
class Feature:
    """A feature with its own register.

    Without `write` it is read-only; a command has only `write`. A `locked` feature cannot be written during
    acquisition. `selects` names the features that depend on this selector.
    """

    name: str
    about: str
    kind: Kind = Kind.INTEGER
    read: Getter | None = None
    write: Setter | None = None
    limits: tuple[Limit, Limit] | None = None
    step: int = 1
    unit: str = ""
    entries: Mapping[str, int] = field(default_factory=dict)
    locked: bool = False
    selects: tuple[str, ...] = ()
    visibility: str = "Beginner"
    category: str = ""

    def accepts(self, camera: FeatureState, value: Number) -> bool:
        """Return whether a value may be written."""
        if self.kind is Kind.ENUMERATION:
            return value in self.entries.values()
        if self.kind is Kind.BOOLEAN:
            return value in (0, 1)
        if self.kind is Kind.COMMAND:
            return True
        low, high = (resolve_limit(limit, camera) for limit in self.limits or (0, 0xFFFFFFFF))
        # NaN fails every comparison.
        within = low <= value <= high
        return within and (self.kind is Kind.FLOAT or (value - low) % self.step == 0)


def resolve_limit(limit: Limit, camera: FeatureState) -> Number:
    """Return the value of a limit, which may depend on the camera's state."""
    return limit(camera) if callable(limit) else limit


def in_category(category: str, *features: Feature) -> tuple[Feature, ...]:
    """Return features as those of a category."""
    return tuple(replace(feature, category=category) for feature in features)


def setting(name: str, about: str, attribute: str, **more: Any) -> Feature:
    """Define a feature backed by an attribute of the frame settings."""
    return Feature(
        name,
        about,
        read=lambda camera: getattr(camera.settings, attribute),
        write=lambda camera, value: setattr(camera.settings, attribute, value),
        **more,
    )


def choice(name: str, about: str, attribute: str, **more: Any) -> Feature:
    """Define an enumeration backed by an attribute of the frame settings."""
    return setting(name, about, attribute, kind=Kind.ENUMERATION, **more)


def trigger_setting(name: str, about: str, attribute: str, kind: Kind, **more: Any) -> Feature:
    """Define a feature backed by an attribute of the selected trigger."""
    return Feature(
        name,
        about,
        kind,
        read=lambda camera: getattr(camera.settings.selected_trigger, attribute),
        write=lambda camera, value: setattr(camera.settings.selected_trigger, attribute, value),
        **more,
    )


def constant(name: str, about: str, value: float, **more: Any) -> Feature:
    """Define a constant feature."""
    return Feature(name, about, read=lambda _camera: value, **more)


def single_choice(name: str, about: str, entry: str, **more: Any) -> Feature:
    """Define an enumeration of the camera family that this camera restricts to a single entry."""
    entries = {entry: 0}
    return constant(name, about, 0, kind=Kind.ENUMERATION, entries=entries, write=ignore, **more)


def ignore(_camera: FeatureState, _value: Number) -> None:
    """Take a value that changes nothing."""


def command(name: str, about: str, do: Callable[[FeatureState], None], **more: Any) -> Feature:
    """Define a command."""
    return Feature(name, about, Kind.COMMAND, write=lambda camera, _value: do(camera), **more)
