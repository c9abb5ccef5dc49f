"""A number as a person types it."""

from __future__ import annotations

import math
import re

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)", re.ASCII)


def without_unit(typed: str, unit: str) -> str:
    """What was typed, without the space around it and the unit that may follow it."""
    words = typed.strip()
    return words[: -len(unit)].rstrip() if unit and words.casefold().endswith(unit.casefold()) else words


def typed_number(typed: str, unit: str = "") -> float:
    """A finite number, with a decimal point or comma; raises ValueError with the text typed.

    The `unit` may follow it, with or without a space; another one may not.
    """
    words = without_unit(typed, unit).replace("\N{MINUS SIGN}", "-")
    number = float(words.replace(",", ".")) if _NUMBER.fullmatch(words) else math.nan
    if not math.isfinite(number):
        raise ValueError(repr(typed.strip()))
    return number
