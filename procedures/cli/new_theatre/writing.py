"""Text of a new theatre file: devices found, all driver options, and entries still to be filled in."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from textwrap import wrap
from typing import Any

import tomli_w
from pydantic import BaseModel, ValidationError

from procedures.calibration.validity import MADE_BY_COMMAND
from procedures.cli.new_theatre.searching import ARM, DeviceTable, Mistakes
from ronna_hw.bounded_input import parse_toml, read_toml
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.config import BadTheatreFile, Calibrations, parse_theatre
from ronna_hw.devices.probing import ONLY, Option, Proposal
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.near_names import find_near
from ronna_hw.roles import ASSISTANT
from ronna_hw.text import format_count

WIDTH = 110
TABLE_NAMES = {"robot": "robot.master"}  # the name under which the procedure uses an arm
COPIED = ("calibration", "tools", "cell", "procedure")  # with `flange`, from another file
HEAD = (
    "Theatre file, created by ronna-procedure new-theatre. Lines that begin with # are comments: an "
    "option in one shows its default. All keys: docs/reference/theatre-file.md; `ronna-procedure "
    "doctor --config FILE` checks the file."
)
NOT_FOUND = "NOT FOUND. This is an example: correct its addresses, then remove the first # of each line."
NO_RECORDS = (
    "No case and no calibration starts without these records. Enter each from the drawing of your "
    "mount, created and expiring on the date of the drawing, then measure: "
)
EMPTY_KEY = '"" = '
_WORD = re.compile(r"'([^']*)'")  # of the values that an option may have, as its model names them
TOOLS = "tools"  # option of a tracker: definitions of the tools to see
# Only in a simulated theatre may records last longer than a year: judged when the devices are known.
ANY_KIND = {"clock": {"endpoint": "shm:///any"}}


def theatre_text(
    name: str, found: Sequence[DeviceTable], clock: str, copied: Mapping[str, Any], banner: str = ""
) -> str:
    """Return a new theatre file as commented TOML; `copied` contains tables from another file."""
    lines = [*_comment(HEAD), "", "schema = 1", _line("theatre", name)]
    if banner:
        lines.append(_line("banner", banner))
    if "flange" in copied:
        lines.append(_line("flange", copied["flange"]))
    lines += ["", "[clock]", _line("endpoint", clock)]
    for one in found:
        lines += ["", *_device_lines(one)]
    rest = {table: copied[table] for table in COPIED if table in copied}
    if "calibration" not in rest:
        lines += ["", *_missing_record_lines()]
    return "\n".join(lines) + "\n" + ("\n" + tomli_w.dumps(rest) if rest else "")


def _device_lines(found: DeviceTable) -> Iterator[str]:
    proposal, table = found.proposal, TABLE_NAMES.get(found.table, found.table)
    title = f"{table}: {proposal.what}" if found.is_found else f"{table}: {NOT_FOUND}"
    if proposal.absent:
        title += f" Searched for it: {proposal.absent}."
    yield from _comment(title)
    for remark in proposal.remarks:
        yield from _comment(f"- {remark}")
    body = list(_table_lines(table, proposal))
    yield from body if found.is_found else (f"# {line}".rstrip() for line in body)


def _table_lines(table: str, proposal: Proposal) -> Iterator[str]:
    endpoints, options = proposal.endpoints, proposal.options
    yield f"[{table}]"
    yield _line("driver", proposal.driver)
    if ONLY in endpoints:
        yield _line("endpoint", endpoints[ONLY])
    else:
        yield from ("", f"[{table}.endpoints]")
        yield from (_line(role, address) for role, address in endpoints.items())
    yield from ("", f"[{table}.options]")
    lists = [option for option in options if option.chosen and _is_list_of_tables(option.value)]
    for option in options:
        if option not in lists:
            yield from _option_lines(option)
    for option in lists:
        for entry in option.value:
            yield from ("", *_comment(option.meaning), f"[[{table}.options.{option.key}]]")
            yield from (_line(key, value) for key, value in entry.items())


def _option_lines(option: Option) -> Iterator[str]:
    yield from _comment(option.meaning)
    if option.chosen:
        yield _line(option.key, option.value)
    else:
        yield f"# {option.key} =" if option.value is None else f"# {_line(option.key, option.value)}"


def _is_list_of_tables(value: object) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(one, dict) for one in value)


def _missing_record_lines() -> Iterator[str]:
    """Yield the keys to fill in by hand before the first calibration."""
    makers = ", ".join(f"[calibration.{name}] by {command}" for name, command in MADE_BY_COMMAND.items())
    yield from _comment(f"{NO_RECORDS}{makers}.")
    for name, table in Calibrations.model_fields.items():
        if not table.is_required() or not isinstance(table.annotation, type):
            continue
        yield from ("#", f"# [calibration.{name}]")
        for key, one in table.annotation.model_fields.items():
            yield from _comment(f"#   {key}: {one.description}")


def _comment(text: str) -> Iterator[str]:
    return (f"# {line}" for line in wrap(text.replace("\n", " "), WIDTH))


def _line(key: str, value: Any) -> str:
    """Format `key = value` on one line of any length; lists and an empty table are written inline."""
    if value == {}:
        return f"{key} = {{}}"
    if isinstance(value, list | tuple) and not _is_list_of_tables(value):
        return f"{key} = [{', '.join(_line('', one).removeprefix(EMPTY_KEY) for one in value)}]"
    if isinstance(value, Enum):
        value = value.value
    return tomli_w.dumps({key: str(value) if isinstance(value, Path) else value}).strip()


class _Definition(BaseModel, extra="allow", strict=True):
    """Tracker tool definition without driver-specific settings."""

    rom: str = ""


class _TrackerOptions(BaseModel, strict=True):
    tools: list[_Definition] = []


class _Tracker(BaseModel, strict=True):
    options: _TrackerOptions = _TrackerOptions()


class _TheatrePart(BaseModel, strict=True):
    """Parts of another theatre file read in addition to its records."""

    tracker: _Tracker = _Tracker()


@dataclass(frozen=True)
class CopiedRecords:
    """Records copied from another theatre file: flange, mount and cell tables, and tracked tools."""

    tables: Mapping[str, Any] = field(default_factory=dict)
    tools: Sequence[Mapping[str, Any]] = ()


def read_records(source: Path) -> CopiedRecords:
    """Read the records to copy from a complete or partial theatre file.

    Raises CFG-001 for a file that cannot be read, has mistakes, or has none of the tables.
    """
    try:
        content = read_toml(source, BadTheatreFile)
    except OSError as error:
        raise BadTheatreFile(
            f"cannot read {source}: {error.strerror}",
            action="Give --records an existing theatre file, or the calibration.toml of a calibration.",
        ) from error
    tables = {name: content[name] for name in ("flange", *COPIED) if name in content}
    if not tables:
        raise BadTheatreFile(f"{source} has none of the tables", expected=", ".join(COPIED))
    parse_theatre({"theatre": source.stem, **ANY_KIND, **tables}, source.name)
    try:
        tools = _TheatrePart.model_validate(content).tracker.options.tools
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise BadTheatreFile(
            f"{source.name} has {format_count(len(mistakes), 'mistake')}: {'; '.join(mistakes)}"
        ) from error
    folder = source.resolve().parent
    resolved_tools = []
    for tool in tools:
        rom_path = folder / tool.rom  # else a definition of the driver, by its name
        rom = str(rom_path) if rom_path.is_file() else tool.rom
        resolved_tools.append({**(tool.model_extra or {}), "rom": rom})
    return CopiedRecords(tables, resolved_tools)


def with_tools(found: Sequence[DeviceTable], tools: Sequence[Mapping[str, Any]]) -> tuple[DeviceTable, ...]:
    """Replace the tracker's tool definitions in the device tables by `tools`, if any."""
    if not tools:
        return tuple(found)
    return tuple(_apply_values(one, {TOOLS: list(tools)}) if one.table == "tracker" else one for one in found)


def with_options(
    found: Sequence[DeviceTable], given: Sequence[str], mistakes: Mistakes
) -> tuple[DeviceTable, ...]:
    """Apply options such as `stereo.exposure_us=1500` (TOML values) to device tables; note each mistake."""
    changed = list(found)

    def apply(text: str) -> None:
        place, equals, value = text.partition("=")
        table, _, key = place.strip().rpartition(".")
        names = [(one.table, TABLE_NAMES.get(one.table)) for one in changed]
        numbers = [n for n, of_device in enumerate(names) if table in of_device]
        if not equals or not numbers:
            tables = list(dict.fromkeys(TABLE_NAMES.get(one.table, one.table) for one in found))
            meant = f"{ARM}.{ASSISTANT}" == table and "With --assistant HOST there is a second arm."
            raise UsageMistake(
                f"--option {text!r}",
                expected=f"TABLE.KEY=VALUE, TABLE one of {', '.join(tables)}",
                action=meant
                or _suggest_option(table, tables, after=f".{key}={value if equals else 'VALUE'}"),
            )
        keys = {n: [option.key for option in changed[n].proposal.options] for n in numbers}
        having = [n for n in numbers if key in keys[n]]
        if not having:
            known = dict.fromkeys(one for n in numbers for one in keys[n])
            raise UsageMistake(
                f"--option: {table} has no option {key!r}",
                expected=f"one of {', '.join(known)}",
                action=_suggest_option(key, list(known), before=f"{table}.", after=f"={value}"),
            )
        refusals = []
        for number in having:  # drivers of several makes may have it, with other limits
            applied = _apply_values(changed[number], {key: _parse_value(value)})
            try:
                _require_fitting(text, applied)
            except UsageMistake as refusal:
                refusals.append(refusal)
                continue
            changed[number] = applied
            return
        raise refusals[0]

    mistakes.collect(apply, given)
    return tuple(changed)


def _require_fitting(text: str, found: DeviceTable) -> None:
    """Raise CLI-001 if the driver rejects a device table because of this option."""
    options = found.proposal.options
    chosen = {option.key: option.value for option in options if option.chosen}
    for model in {option.model for option in options if option.model is not None}:
        try:
            model.model_validate_json(json.dumps(chosen, default=str))
        except ValidationError as error:
            place, _, value = text.partition("=")
            words = [_WORD.findall(str(one.get("ctx", {}).get("expected", ""))) for one in error.errors()]
            known = [word for each in words for word in each]
            raise UsageMistake(
                f"--option {text!r}: {'; '.join(describe_mistakes(error, model))}",
                action=_suggest_option(value.strip(" \"'"), known, before=f"{place}=")
                or "The reference lists the options of each driver and their values.",
            ) from error


def _suggest_option(typed: str, known: Sequence[str], *, before: str = "", after: str = "") -> str | None:
    """Suggest an option with the known word that is most like the one typed, or None if none is."""
    alike = find_near(typed, known)
    return f"Did you mean --option {shlex.quote(before + alike[0] + after)}?" if alike else None


def _apply_values(found: DeviceTable, values: Mapping[str, Any]) -> DeviceTable:
    options = tuple(
        replace(one, value=values[one.key], chosen=True) if one.key in values else one
        for one in found.proposal.options
    )
    return replace(found, proposal=replace(found.proposal, options=options))


def _parse_value(text: str) -> Any:
    """Parse a TOML value, falling back to the text itself."""
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text.strip()
