"""Pydantic models as Markdown tables, with one row per field: type, default and meaning."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel
from reference_tables import table

SHOWN_DEFAULT = 24  # characters; a longer one is not for a table


def model_tables(titles: Mapping[str, type[BaseModel]]) -> str:
    """Tabulate the titled models, then all nested models once each, sorted by name."""
    schemas = {title: model.model_json_schema() for title, model in titles.items()}
    definitions = {name: one for schema in schemas.values() for name, one in schema.get("$defs", {}).items()}
    contained = sorted((name, one) for name, one in definitions.items() if "properties" in one)
    return "\n".join(
        f"## {title}\n\n{schema.get('description', '')}\n\n"
        + table(("key", "type", "default", "meaning"), _make_rows(schema, definitions))
        for title, schema in (*schemas.items(), *contained)
    )


def _make_rows(schema: dict[str, Any], definitions: dict[str, Any]) -> Iterable[tuple[str, ...]]:
    required = schema.get("required", [])
    for key, value in schema.get("properties", {}).items():
        default = "required" if key in required else _format_default(value)
        nullable = key in required and {"type": "null"} in value.get("anyOf", ())
        kind = _format_type(value, definitions) + (" or null" if nullable else "")
        yield f"`{key}`", kind, default, value.get("description", "")


def _format_default(value: dict[str, Any]) -> str:
    default = value.get("default")
    if isinstance(default, dict) and default:
        return "see its table"
    shown = "" if default in (None, "", [], {}) else str(default)
    return "built in" if len(shown) > SHOWN_DEFAULT else shown


def _format_type(value: dict[str, Any], definitions: dict[str, Any]) -> str:
    if "$ref" in value:
        name = str(value["$ref"]).rsplit("/", 1)[-1]
        choices = definitions[name].get("enum")
        return " or ".join(f"`{choice}`" for choice in choices) if choices else name
    if "anyOf" in value:
        return " or ".join(
            _format_type(one, definitions) for one in value["anyOf"] if one.get("type") != "null"
        )
    if isinstance(value.get("additionalProperties"), dict):
        return f"table of {_format_type(value['additionalProperties'], definitions)}"
    if value.get("type") == "array":
        each = value.get("items") or (value.get("prefixItems") or [{}])[0]
        return f"{_format_length(value)} {_format_type(each, definitions)}"
    if "enum" in value:
        return " or ".join(f"`{choice}`" for choice in value["enum"])
    return str(value.get("const") or value.get("format") or value.get("type") or "any") + _format_bounds(
        value
    )


def _format_length(value: dict[str, Any]) -> str:
    least, most = value.get("minItems"), value.get("maxItems")
    if most is None:
        return "list of"
    return str(most) if least == most else f"{least or 0} to {most}"


def _format_bounds(value: dict[str, Any]) -> str:
    """Say which numbers are accepted, if not all are."""
    if "minimum" in value and "maximum" in value:
        return f", {value['minimum']:.10g} to {value['maximum']:.10g}"
    words = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    return "".join(f", {word} {value[bound]:.10g}" for bound, word in words.items() if bound in value)
