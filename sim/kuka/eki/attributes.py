"""Attributes of EKI commands: read strictly, written so that every parser accepts them."""

from __future__ import annotations

from collections.abc import Mapping

from ronna_hw.wire.kuka_eki import AXIS_ATTRIBUTES

LARGEST = 1e6  # mm or degrees: a pose far out of reach, whose squares are still numbers
LEAST_PERCENT = 0.001  # of a speed: a motion that never ends has no duration to calculate with
FRAME = ("X", "Y", "Z", "A", "B", "C")
_ESCAPED = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": " ", "\r": " "})


def whole(given: Mapping[str, str], name: str, otherwise: int | None = None) -> int:
    """An integer; ValueError when it is malformed, or missing without a default."""
    if otherwise is not None and name not in given:
        return otherwise
    try:
        return int(given[name])
    except (KeyError, ValueError):
        raise ValueError(f"{name} is missing or not an integer") from None


def flag(given: Mapping[str, str], name: str) -> bool:
    """0 or 1; ValueError for anything else."""
    if given.get(name) not in ("0", "1"):
        raise ValueError(f"{name} is 0 or 1")
    return given[name] == "1"


def number(given: Mapping[str, str], name: str, otherwise: float | None = None) -> float:
    """A number of at most `LARGEST` in magnitude; ValueError for others, and as for `whole`."""
    if otherwise is not None and name not in given:
        return otherwise
    try:
        value = float(given[name])
    except (KeyError, ValueError):
        value = float("nan")
    if not abs(value) <= LARGEST:
        raise ValueError(f"{name} is missing or not a number up to {LARGEST:g}")
    return value


def share(given: Mapping[str, str], name: str) -> float:
    """A percentage of at most 100 as a fraction; 1 if missing."""
    value = number(given, name, 100.0)
    if not LEAST_PERCENT <= value <= 100.0:
        raise ValueError(f"{name} must be a percentage from {LEAST_PERCENT} to 100")
    return value / 100.0


def frame(given: Mapping[str, str]) -> list[float]:
    """X Y Z (mm) A B C (deg)."""
    return [number(given, name) for name in FRAME]


def axes(given: Mapping[str, str]) -> list[float]:
    """A1 to A6 (deg)."""
    return [number(given, name) for name in AXIS_ATTRIBUTES]


def text(content: str, longest: int) -> str:
    """An attribute's value, not longer than a KRL string."""
    return content[:longest].translate(_ESCAPED)
