"""The pages of the files that people write: every table of a theatre file and of a scene, key by key."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel

from ronna_hw.config import TheatreFile
from sim.theatre.scene.model import Scene

THEATRE_HEAD = """# Keys of the theatre file

TOML. All tables are strict: unknown keys are errors, and all mistakes are told at once. Lengths are
millimetres, poses are target <- source. `ronna-sim theatre` writes such a file to begin with.
"""
SCENE_HEAD = """# Keys of a scene

What is true in a simulated theatre, as TOML or JSON for `--scene FILE`. All tables are strict. Lengths are
millimetres, angles radians where the name says `rad`, CT coordinates DICOM's LPS, poses target <- source.
`ronna-sim scene --scene mini --seed 4 > scene.toml` writes a built-in one to begin with.
"""
SHOWN_DEFAULT = 24  # characters; a longer one is not for a table


def key_pages() -> dict[str, str]:
    """File name -> content of the page of each file."""
    return {
        "scene-file.md": _page(SCENE_HEAD, "scene", Scene),
        "theatre-file.md": _page(THEATRE_HEAD, "theatre file", TheatreFile),
    }


def _page(head: str, name: str, model: type[BaseModel]) -> str:
    schema = model.model_json_schema()
    tables = sorted((name, table) for name, table in schema["$defs"].items() if "properties" in table)
    lines = [head]
    for title, table in ((name, schema), *tables):
        lines += [f"## {title}\n", table.get("description", "") + "\n"]
        lines += [
            "| key | type | default | meaning |",
            "|---|---|---|---|",
            *_rows(table, schema["$defs"]),
            "",
        ]
    return "\n".join(lines)


def _rows(table: dict[str, Any], definitions: dict[str, Any]) -> Iterable[str]:
    required = table.get("required", [])
    for key, value in table["properties"].items():
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
