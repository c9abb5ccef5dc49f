"""A number as a person types it."""

from __future__ import annotations

import math


def without_unit(typed: str, unit: str) -> str:
    """What was typed, without the space around it and the unit that may follow it."""
    words = typed.strip()
    return words[: -len(unit)].rstrip() if unit and words.casefold().endswith(unit.casefold()) else words


def typed_number(typed: str, unit: str = "") -> float:
    """A finite number, with a decimal point or comma; raises ValueError with the text typed.

    The `unit` may follow it, with or without a space; another one may not.
    """
    words = typed.strip()
    try:
        number = float(without_unit(words, unit).replace(",", "."))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(repr(words))
    return number
