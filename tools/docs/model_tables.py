"""A pydantic model as Markdown tables: a row per field with its type, default and meaning."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel

SHOWN_DEFAULT = 24  # characters; a longer one is not for a table


def model_tables(titles: Mapping[str, type[BaseModel]]) -> str:
    """The models under their titles, then every model that they contain, once and by name."""
    schemas = {title: model.model_json_schema() for title, model in titles.items()}
    definitions = {name: one for schema in schemas.values() for name, one in schema.get("$defs", {}).items()}
    contained = sorted((name, one) for name, one in definitions.items() if "properties" in one)
    lines: list[str] = []
    for title, table in (*schemas.items(), *contained):
        lines += [f"## {title}\n", table.get("description", "") + "\n"]
        lines += ["| key | type | default | meaning |", "|---|---|---|---|", *_rows(table, definitions), ""]
    return "\n".join(lines)


def _rows(table: dict[str, Any], definitions: dict[str, Any]) -> Iterable[str]:
    required = table.get("required", [])
    for key, value in table.get("properties", {}).items():
        default = "needed" if key in required else _default(value)
        yield f"| `{key}` | {_type(value, definitions)} | {default} | {value.get('description', '')} |"


def _default(value: dict[str, Any]) -> str:
    default = value.get("default")
    if isinstance(default, dict):
        return "see there"
    shown = "" if default in (None, "", []) else str(default)
    return "as built in" if len(shown) > SHOWN_DEFAULT else shown


def _type(value: dict[str, Any], definitions: dict[str, Any]) -> str:
    if "$ref" in value:
        name = str(value["$ref"]).rsplit("/", 1)[-1]
        choices = definitions[name].get("enum")
        return " or ".join(f"`{choice}`" for choice in choices) if choices else name
    if "anyOf" in value:
        return " or ".join(_type(one, definitions) for one in value["anyOf"] if one.get("type") != "null")
    if isinstance(value.get("additionalProperties"), dict):
        return f"table of {_type(value['additionalProperties'], definitions)}"
    if value.get("type") == "array":
        each = value.get("items") or (value.get("prefixItems") or [{}])[0]
        return f"{value.get('maxItems', 'list of')} {_type(each, definitions)}"
    if "enum" in value:
        return " or ".join(f"`{choice}`" for choice in value["enum"])
    return str(value.get("const") or value.get("format") or value.get("type") or "any")
