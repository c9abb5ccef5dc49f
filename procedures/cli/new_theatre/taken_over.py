"""What a new theatre file copies from another: records, tools, cell, and the options that were named."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from procedures.cli.new_theatre.searching import Found
from procedures.cli.new_theatre.writing import TABLE_NAMES, TAKEN_OVER
from ronna_hw.bounded_input import parse_toml, read_toml
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.config import BadTheatreFile, parse_theatre
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import counted

TOOLS = "tools"  # option of a tracker: definitions of what it is to see
# Only in a simulated theatre may records last longer than a year: judged when the devices are known.
ANY_KIND = {"clock": {"endpoint": "shm:///any"}}


class _Definition(BaseModel, extra="allow", strict=True):
    """One tool of a tracker, whatever else its driver knows of it."""

    rom: str = ""


class _TrackerOptions(BaseModel, strict=True):
    tools: list[_Definition] = []


class _Tracker(BaseModel, strict=True):
    options: _TrackerOptions = _TrackerOptions()


class _TheatrePart(BaseModel, strict=True):
    """What is read of another theatre file besides its records."""

    tracker: _Tracker = _Tracker()


@dataclass(frozen=True)
class TakenOver:
    """`flange`, the tables that belong to mount and cell, and the tools that the tracker is to see."""

    tables: Mapping[str, Any]
    tools: Sequence[Mapping[str, Any]]


def read_records(source: Path) -> TakenOver:
    """From a theatre file or a part of one.

    Raises CFG-001 for a file that cannot be read, has mistakes, or has none of the tables.
    """
    try:
        content = read_toml(source, BadTheatreFile)
    except OSError as error:
        raise BadTheatreFile(
            f"cannot read {source}: {error.strerror}",
            action="Give --records an existing theatre file, or the calibration.toml of a calibration.",
        ) from error
    tables = {name: content[name] for name in ("flange", *TAKEN_OVER) if name in content}
    if not tables:
        raise BadTheatreFile(f"{source} has none of the tables", expected=", ".join(TAKEN_OVER))
    parse_theatre({"theatre": source.stem, **ANY_KIND, **tables}, source.name)
    try:
        tools = _TheatrePart.model_validate(content).tracker.options.tools
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise BadTheatreFile(
            f"{source.name} has {counted(len(mistakes), 'mistake')}: {'; '.join(mistakes)}"
        ) from error
    folder = source.resolve().parent
    whole = [{**(tool.model_extra or {}), "rom": _where(tool.rom, folder)} for tool in tools]
    return TakenOver(tables, whole)


def with_tools(found: Sequence[Found], tools: Sequence[Mapping[str, Any]]) -> tuple[Found, ...]:
    """The tracker with the tool definitions of another theatre file, if that names some."""
    if not tools:
        return tuple(found)
    return tuple(_changed(one, {TOOLS: list(tools)}) if one.table == "tracker" else one for one in found)


def with_options(found: Sequence[Found], given: Sequence[str]) -> tuple[Found, ...]:
    """With options such as `stereo.exposure_us=1500`, values as TOML has them. Raises CLI-001."""
    changed = list(found)
    for text in given:
        place, equals, value = text.partition("=")
        table, _, key = place.strip().rpartition(".")
        number = next((n for n, one in enumerate(changed) if _named(one, table)), None)
        if not equals or number is None:
            tables = ", ".join(TABLE_NAMES.get(one.table, one.table) for one in found)
            raise UsageMistake(f"--option {text!r}", expected=f"TABLE.KEY=VALUE, TABLE one of {tables}")
        known = [option.key for option in changed[number].proposal.options]
        if key not in known:
            raise UsageMistake(
                f"--option: {table} has no option {key!r}", expected=f"one of {', '.join(known)}"
            )
        changed[number] = _changed(changed[number], {key: _value(value)})
        _require_fitting(text, changed[number])
    return tuple(changed)


def _require_fitting(text: str, found: Found) -> None:
    """Raise CLI-001 where the driver would not take its options with this one."""
    options = found.proposal.options
    chosen = {option.key: option.value for option in options if option.chosen}
    for model in {option.model for option in options if option.model is not None}:
        try:
            model.model_validate_json(json.dumps(chosen, default=str))
        except ValidationError as error:
            raise UsageMistake(
                f"--option {text!r}: {'; '.join(describe_mistakes(error, model))}",
                action="The reference lists the options of each driver and their values.",
            ) from error


def _named(found: Found, table: str) -> bool:
    return table in (found.table, TABLE_NAMES.get(found.table))


def _where(rom: str, folder: Path) -> str:
    """A definition beside the other file, by its whole path; one that comes with the driver, by its name."""
    beside = folder / rom
    return str(beside) if beside.is_file() else rom


def _changed(found: Found, values: Mapping[str, Any]) -> Found:
    options = tuple(
        replace(one, value=values[one.key], chosen=True) if one.key in values else one
        for one in found.proposal.options
    )
    return replace(found, proposal=replace(found.proposal, options=options))


def _value(text: str) -> Any:
    """A value of TOML, or else the text itself."""
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text.strip()
