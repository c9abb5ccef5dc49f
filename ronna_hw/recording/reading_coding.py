"""What devices answer, as plain JSON values and back: records, tuples, enumerations, numbers, pixels."""

from __future__ import annotations

import types
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

PIXELS = "kept pixels"  # the key of a reference to pixels that are kept elsewhere

PutPixels = Callable[[Any], dict[str, Any]]
GetPixels = Callable[[dict[str, Any]], Any]


def as_plain(value: Any, put: PutPixels) -> Any:
    """A value as JSON has it; `put` takes arrays of pixels and returns what refers to them."""
    if isinstance(value, np.ndarray):
        return {PIXELS: put(value)}
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: as_plain(getattr(value, field.name), put) for field in fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: as_plain(part, put) for name, part in value._asdict().items()}
    if isinstance(value, tuple | list):
        return [as_plain(part, put) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def as_recorded(kind: Any, value: Any, get: GetPixels) -> Any:
    """The value of a declared type again. Raises ValueError, KeyError or TypeError for what is none."""
    if isinstance(value, dict) and PIXELS in value:
        return get(value[PIXELS])
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None:
            return None
        return as_recorded(next(one for one in arguments if one is not type(None)), value, get)
    if origin is tuple:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            return tuple(as_recorded(arguments[0], part, get) for part in value)
        return tuple(as_recorded(one, part, get) for one, part in zip(arguments, value, strict=True))
    if isinstance(kind, type) and (is_dataclass(kind) or hasattr(kind, "_fields")):
        hints = _hints(kind)
        return kind(**{name: as_recorded(hints[name], part, get) for name, part in value.items()})
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    if kind is float:
        return float(value)
    return value


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)
