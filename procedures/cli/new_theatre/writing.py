"""The text of a new theatre file: what was found, every option of its driver, what is still missing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from textwrap import wrap
from typing import Any

from procedures.calibration.validity import MADE_BY_COMMAND
from procedures.cli.new_theatre.searching import Found
from ronna_hw.config import Calibrations
from ronna_hw.devices.probing import ONLY, Option, Proposal

WIDTH = 110
TABLE_NAMES = {"robot": "robot.master"}  # the name under which the procedure uses an arm
TAKEN_OVER = ("calibration", "tools", "cell", "procedure")  # with `flange`, from another file

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


@dataclass(frozen=True)
class Draft:
    """Everything that goes into the file."""

    name: str
    found: Sequence[Found]
    clock: str = "host:"
    banner: str = ""
    taken_over: Mapping[str, Any] = field(default_factory=dict)  # tables of another file


def theatre_text(draft: Draft) -> str:
    """The file, as TOML with comments."""
    lines = [*_comment(HEAD), "", "schema = 1", _line("theatre", draft.name)]
    if draft.banner:
        lines.append(_line("banner", draft.banner))
    if "flange" in draft.taken_over:
        lines.append(_line("flange", draft.taken_over["flange"]))
    lines += ["", "[clock]", _line("endpoint", draft.clock)]
    for found in draft.found:
        lines += ["", *_device(found)]
    rest = {name: draft.taken_over[name] for name in TAKEN_OVER if name in draft.taken_over}
    if "calibration" not in rest:
        lines += ["", *_missing_records()]
    return "\n".join(lines) + "\n" + ("\n" + _toml(rest) if rest else "")


def _device(found: Found) -> Iterator[str]:
    proposal, table = found.proposal, TABLE_NAMES.get(found.table, found.table)
    title = f"{table}: {proposal.what}" if found.there else f"{table}: {NOT_FOUND}"
    if proposal.absent:
        title += f" Searched for it: {proposal.absent}."
    yield from _comment(title)
    for remark in proposal.remarks:
        yield from _comment(f"- {remark}")
    body = list(_tables(table, proposal))
    yield from body if found.there else (f"# {line}".rstrip() for line in body)


def _tables(table: str, proposal: Proposal) -> Iterator[str]:
    endpoints, options = proposal.endpoints, proposal.options
    yield f"[{table}]"
    yield _line("driver", proposal.driver)
    if ONLY in endpoints:
        yield _line("endpoint", endpoints[ONLY])
    else:
        yield from ("", f"[{table}.endpoints]")
        yield from (_line(role, address) for role, address in endpoints.items())
    yield from ("", f"[{table}.options]")
    lists = [option for option in options if option.chosen and _of_tables(option.value)]
    for option in options:
        if option not in lists:
            yield from _option(option)
    for option in lists:
        for entry in option.value:
            yield from ("", *_comment(option.meaning), f"[[{table}.options.{option.key}]]")
            yield from (_line(key, value) for key, value in entry.items())


def _option(option: Option) -> Iterator[str]:
    yield from _comment(option.meaning)
    if option.chosen:
        yield _line(option.key, option.value)
    else:
        yield f"# {option.key} =" if option.value is None else f"# {_line(option.key, option.value)}"


def _of_tables(value: object) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(one, dict) for one in value)


def _missing_records() -> Iterator[str]:
    """What must be entered by hand before the first calibration, key by key."""
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
    """`key = value`, as long as it is; an empty table stays on the line."""
    if value == {}:
        return f"{key} = {{}}"
    return _toml({key: _plain(value)}).strip()


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    return str(value) if isinstance(value, Path) else value


def _toml(content: Mapping[str, Any]) -> str:
    import tomli_w

    return tomli_w.dumps(content)
