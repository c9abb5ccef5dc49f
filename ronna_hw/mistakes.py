"""Wording of pydantic validation errors for people editing the file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from ronna_hw.near_names import find_near
from ronna_hw.plausible import NAME_PATTERN
from ronna_hw.text import format_count, unit_of

# Kinds of files, by a key that only they have.
KINDS = {
    "trajectories": "a plan",
    "theatre": "a theatre file",
    "answers": "a file of answers",
    "head": "a scene",
    "part_number": "a tool description",
    "wiring": "an RSI context",
}
MISTAKES_SHOWN = 20  # per file: more help no one, and a hostile file has thousands
# Mistakes about a number's bounds, as pydantic names them.
BOUNDS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
QUOTED = re.compile(r"'([^']+)'")  # words of a list, as pydantic writes them
DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+\s*")
UNQUOTED = ("float_type", "int_type", "bool_type")


def find_other_kind(content: Mapping[str, object], own: str) -> str | None:
    """Return the kind of a file that lacks its own key and has that of another kind."""
    if own in content:
        return None
    return next((kind for key, kind in KINDS.items() if key in content), None)


def describe_mistakes(error: ValidationError, model: type[BaseModel] | None = None) -> list[str]:
    """Describe each mistake in one line (location, expected, found), then count any not shown.

    With the validated model, an unknown key is reported with the known ones at its place.
    """
    lines = []
    listed: set[tuple[str, ...]] = set()  # known keys, once for each table
    found = mistakes_in(error)
    for item in found[:MISTAKES_SHOWN]:
        location = _format_place(item["loc"])
        message = describe_mistake(item)
        if item["type"] == "extra_forbidden":
            known = () if model is None else list_known_keys(model, item["loc"][:-1])
            key = str(item["loc"][-1])
            message = (
                f"unknown key{suggest_alike(key, known) if known in listed else suggest_keys(key, known)}"
            )
            if "(known:" in message:
                listed.add(known)
        value = item.get("input")
        found_is = str(value) if isinstance(value, date) else repr(value)
        shown = f" (found {found_is})" if isinstance(value, str | int | float | bool | date) else ""
        lines.append(f"{location}: {message}{shown}")
    if len(found) > MISTAKES_SHOWN:
        lines.append(f"and {len(found) - MISTAKES_SHOWN} more mistakes")
    return lines


def count_mistakes(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """Describe the mistakes in one line with their count: `2 mistakes: a: is missing; b: unknown key`."""
    mistakes = describe_mistakes(error, model)
    return f"{format_count(len(mistakes_in(error)), 'mistake')}: {'; '.join(mistakes)}"


def mistakes_in(error: ValidationError) -> list[ErrorDetails]:
    """Return all mistakes, except lists that are too short only because some of their items are invalid."""
    return [item for item in error.errors(include_url=False) if not _is_only_emptied(item)]


def _is_only_emptied(item: ErrorDetails) -> bool:
    given = item["input"]
    return (
        item["type"] == "too_short"
        and isinstance(given, Sequence)
        and len(given) >= item.get("ctx", {}).get("min_length", 0)
    )


def _format_place(parts: tuple[int | str, ...]) -> str:
    """Format the location of a mistake, such as `trajectories 1.entry_mm`; list items count from 1."""
    text = ""
    for part in parts:
        text += f" {part + 1}" if isinstance(part, int) else f".{part}"
    return text.strip(" .") or "file"


def list_known_keys(model: type[BaseModel], place: tuple[int | str, ...]) -> tuple[str, ...]:
    """Return the keys of a model or of the model nested at `place`, or an empty tuple without a model."""
    here: Any = model
    for part in place:
        names = {field.alias or name: field.annotation for name, field in _fields(here).items()}
        if names and str(part) in names:
            here = _find_model(names[str(part)])
    return tuple(field.alias or name for name, field in _fields(here).items())


def _fields(model: Any) -> dict[str, FieldInfo]:
    return model.model_fields if isinstance(model, type) and issubclass(model, BaseModel) else {}


def _find_model(annotation: Any) -> Any:
    """Find the model in a field annotation: plain, optional, or as the values of a table or list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = map(_find_model, get_args(annotation))
    return next((model for model in found if model is not None), None)


def suggest_alike(key: str, known: Sequence[str]) -> str:
    """Suggest the most similar known key as a question, if one is similar."""
    alike = find_near(key, known)
    return f" (did you mean '{alike[0]}'?)" if alike else ""


def suggest_keys(key: str, known: Sequence[str]) -> str:
    """Suggest the most similar known key as a question, or else list all known keys."""
    return suggest_alike(key, known) or (f" (known: {', '.join(known)})" if known else "")


def _unit_of_place(place: tuple[int | str, ...]) -> str:
    """Return the unit of the nearest named field at a place, which an item of a list shares."""
    return next((unit_of(part) for part in reversed(place) if isinstance(part, str)), "")


def describe_mistake(item: ErrorDetails) -> str:
    """Describe a mistake without its location or the value found."""
    context = item.get("ctx", {})
    match item["type"]:
        case "missing":
            return "is missing"
        case "model_type":
            return "expected a table"
        case "too_long" | "too_short" if "actual_length" in context:
            values = f"{context['actual_length']} values, expected"
            if (at_most := context.get("max_length")) is None:
                return f"{values} {context['min_length']} or more"
            return f"{values} {at_most}: a decimal comma?"
        case "string_pattern_mismatch" if context.get("pattern") == NAME_PATTERN:
            return "expected letters, digits, _ . or -, a letter or a digit first"
        case "datetime_type" | "datetime_parsing" | "datetime_from_date_parsing":
            quoted = ", without quotes in TOML" if isinstance(item["input"], str) else ""
            return f"expected day, time and time zone, as 2026-12-21T12:00:00Z{quoted}"
        case "int_type" | "int_parsing" | "int_from_float":
            return f"expected a whole number{' without quotes' if _is_only_quoted(item['input']) else ''}"
    if item["type"] in ("enum", "literal_error") and isinstance(item["input"], str):
        meant = suggest_alike(item["input"], QUOTED.findall(context["expected"]))
        return f"expected {context['expected']}{meant}"
    message_text = item["msg"].removeprefix("Value error, ")
    if item["type"] in BOUNDS:
        message_text = f"{message_text} {_unit_of_place(item['loc'])}".rstrip()
    for prefix in ("Input should be", "String should have"):
        message_text = message_text.replace(prefix, "expected", 1)
    if item["type"] == "string_type" and isinstance(item["input"], int | float):
        return "expected text: put it in quotes"
    is_to_unquote = item["type"] in UNQUOTED and _is_only_quoted(item["input"])
    if item["type"] in ("float_type", "float_parsing") and DECIMAL_COMMA.fullmatch(str(item["input"])):
        return f"{message_text}, with a decimal point: {str(item['input']).replace(',', '.')}"
    return f"{message_text} without quotes" if is_to_unquote else message_text


def _is_only_quoted(value: object) -> bool:
    if not isinstance(value, str):
        return False
    try:
        float(value)
    except ValueError:
        return value in ("true", "false")
    return True
