"""Simulated device parameters, set as NAME=VALUE and stored in the fields of a frozen dataclass.

Each field is annotated with its meaning and optionally its largest value. A number may be 0 only if that is
its default; otherwise it is positive.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any, ClassVar, Literal, Self, get_args, get_origin, get_type_hints

import typer

from ronna_hw.errors import AnyCode, ConfigurationError
from ronna_hw.near_names import find_near

TRUE_WORDS, FALSE_WORDS = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


@dataclass(frozen=True)
class MaximumValue:
    """Upper limit of a parameter."""

    value: float


@dataclass(frozen=True)
class NamedParameters:
    """Parameters of a device, in the fields of a frozen dataclass; `refusal` is raised for a mistake."""

    refusal: ClassVar[AnyCode[ConfigurationError]]

    @classmethod
    def parse(cls, assignments: Iterable[str]) -> Self:
        """Apply `NAME=VALUE` assignments to the defaults; raises `refusal` for an unknown name or value."""
        values: dict[str, Any] = {}
        kinds = _list_kinds(cls)
        for assignment in assignments:
            name, _, text = assignment.partition("=")
            if name not in kinds:
                alike = " or ".join(find_near(name, kinds, 3)) or f"one of {len(kinds)} names"
                raise cls.refusal(f"unknown parameter {name!r}", expected=alike)
            kind, _, *most = kinds[name]
            value, expected = _parse_value(kind, text, getattr(cls, name), most)
            if value is None:
                raise cls.refusal(f"{name} cannot be {text!r}", expected=expected)
            values[name] = value
        return cls(**values)


class ControllerOfArm(NamedParameters):
    """Parameters of an arm's controller, which states a serial number."""

    serial_number: int

    def of_arm(self, number: int) -> Self:
        """Return those of the arm with this number in a theatre: no two have one serial number."""
        return replace(self, **{"serial_number": self.serial_number + number})


def rows(parameters: type) -> list[tuple[str, str, str]]:
    """List each parameter's name, default and meaning, including the choices of enumerations."""
    found = []
    for name, (kind, meaning, *_) in _list_kinds(parameters).items():
        default: Any = getattr(parameters, name)
        text = f"{int(default):02X}" if isinstance(default, IntEnum) else str(default)
        choices = f" ({', '.join(get_args(kind))})" if get_origin(kind) is Literal else ""
        found.append((name, text if choices else text.lower(), meaning + choices))
    return found


def print_rows(parameters: type) -> None:
    """Print the parameters for `--list-parameters`."""
    for name, value, meaning in rows(parameters):
        typer.echo(f"{name}={value}  {meaning}")


def _list_kinds(parameters: Any) -> dict[str, tuple[Any, ...]]:
    """Return the type, meaning and upper limit (if any) of each parameter."""
    hints = get_type_hints(parameters, include_extras=True)
    return {entry.name: get_args(hints[entry.name]) for entry in fields(parameters)}


def _parse_value(kind: Any, text: str, default: Any, most: list[MaximumValue]) -> tuple[Any, str]:
    """Parse a value and return it (None if invalid) with a description of what was expected."""
    if get_origin(kind) is Literal:
        return (text if text in get_args(kind) else None), " or ".join(get_args(kind))
    if kind is bool:
        word = text.lower()
        return (word in TRUE_WORDS if word in TRUE_WORDS + FALSE_WORDS else None), "true or false"
    if kind is str:
        return text or None, "a text"
    enumeration_values = issubclass(kind, IntEnum)
    largest = most[0].value if most else math.inf
    least = "of at least 0" if default == 0 else "above 0"
    expected = f"{'a whole number' if kind is int else 'a number'} {least}"
    expected += f", at most {largest:g}" if most else ""
    expected = "an error code of two hexadecimal digits" if enumeration_values else expected
    try:
        value = kind(int(text, 16)) if enumeration_values else kind(text)
    except ValueError:
        return None, expected
    least_met = value > 0 or (default == 0 and value == 0)
    in_range = enumeration_values or (least_met and value <= largest and value < math.inf)
    return (value if in_range else None), expected
