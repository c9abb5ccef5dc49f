"""Device answers as plain JSON values and back: records, tuples, enumerations, numbers, pixels."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

PIXELS = "kept pixels"  # the key of a reference to pixels stored elsewhere

PutPixels = Callable[[Any], dict[str, Any]]
GetPixels = Callable[[dict[str, Any]], Any]


def as_plain(value: Any, put: PutPixels) -> Any:
    """A value in JSON form; `put` stores arrays of pixels and returns a reference.

    Raises ValueError or TypeError for values without such a form.
    """

    def other(part: Any) -> Any:
        if isinstance(part, np.ndarray):
            return {PIXELS: put(part)}
        if isinstance(part, np.generic):
            return part.item()
        raise TypeError(f"{type(part).__name__} has no plain form")

    return to_jsonable_python(value, fallback=other)


def as_recorded(kind: Any, value: Any, get: GetPixels) -> Any:
    """The value of a declared type back. Raises ValueError, KeyError or TypeError if it is not one."""
    return _adapter(kind).validate_python(_with_pixels(value, get))


def _with_pixels(value: Any, get: GetPixels) -> Any:
    if isinstance(value, dict):
        if PIXELS in value:
            return get(value[PIXELS])
        return {name: _with_pixels(part, get) for name, part in value.items()}
    return [_with_pixels(part, get) for part in value] if isinstance(value, list) else value


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    adapter = TypeAdapter(kind)
    # Readings import NumPy for their annotations only; they are complete with these names.
    adapter.rebuild(raise_errors=False, _types_namespace={"np": np, "NDArray": NDArray})
    return adapter
