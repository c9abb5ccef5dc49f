"""A number as a person types it."""

from __future__ import annotations

import math


def typed_number(typed: str) -> float:
    """A finite number, with a decimal point or comma; raises ValueError with the text typed."""
    words = typed.strip()
    try:
        number = float(words.replace(",", "."))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(repr(words))
    return number
