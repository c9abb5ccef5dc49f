"""What a validator found, in the words of whoever edits the file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic_core import ErrorDetails

from ronna_hw.trajectory_bounds import NAME_PATTERN

UNQUOTED = ("float_type", "int_type", "bool_type")


def in_words(item: ErrorDetails) -> str:
    """The message of one mistake, without its place and without what was found there."""
    context = item.get("ctx", {})
    match item["type"]:
        case "missing":
            return "is missing"
        case "model_type":
            return "expected a table"
        case "too_long" | "too_short" if "actual_length" in context:
            return _count_wrong(context)
        case "string_pattern_mismatch" if context.get("pattern") == NAME_PATTERN:
            return "expected letters, digits, _ . or -, a letter or a digit first"
    said = item["msg"].removeprefix("Value error, ")
    for prefix in ("Input should be", "String should have"):
        said = said.replace(prefix, "expected", 1)
    if item["type"] == "string_type" and isinstance(item["input"], int | float):
        return "expected text: put it in quotes"
    return f"{said} without quotes" if item["type"] in UNQUOTED and _only_quoted(item["input"]) else said


def _only_quoted(value: object) -> bool:
    if not isinstance(value, str):
        return False
    try:
        float(value)
    except ValueError:
        return value in ("true", "false")
    return True


def _count_wrong(limits: Mapping[str, Any]) -> str:
    """The number of values, and the expected number."""
    if "max_length" in limits:
        return f"{limits['actual_length']} values, expected {limits['max_length']}: a decimal comma?"
    return f"{limits['actual_length']} values, expected {limits['min_length']} or more"
