"""Records of a theatre file that were edited by hand but still have the identifier of the former ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from procedures.runs.theatre_history import TheatreState, describe_state, read_states
from ronna_hw.bounded_input import parse_toml_bytes
from ronna_hw.config import BadTheatreFile

TABLES = ("calibration", "tools")
ADDED_BY_HAND = "tools"  # fields such as `bodies`, which no command writes, may be added to a record


@dataclass(frozen=True)
class EditedRecord:
    """A record whose values are not those of the update, or first state, that its identifier came with."""

    place: str  # such as `calibration.tool_tip`
    identifier: str
    fields: tuple[str, ...]
    since: str  # what led to the state with its values


def edited_records(theatre: Path) -> tuple[EditedRecord, ...]:
    """Compare the records of a theatre file with its history. Raises PRO-046, OSError."""
    known: dict[str, tuple[TheatreState, dict[str, Any]]] = {}
    above: dict[str, dict[str, Any]] = {}
    for state in read_states(theatre):
        now = dict(_records(state))
        for place, record in now.items():
            is_signed = state.update is not None and above.get(place) != record
            if is_signed or place not in known or known[place][1]["identifier"] != record["identifier"]:
                known[place] = state, record
        above = now
    return tuple(
        EditedRecord(place, record["identifier"], fields, describe_state(known[place][0]))
        for place, record in above.items()
        if (fields := tuple(_changed_fields(place, known[place][1], record)))
    )


def _records(state: TheatreState) -> Iterator[tuple[str, dict[str, Any]]]:
    content = parse_toml_bytes(state.text.encode(), f"state {state.number}", BadTheatreFile)
    for table in TABLES:
        for name, record in content.get(table, {}).items():
            if isinstance(record, dict) and "identifier" in record:
                yield f"{table}.{name}", record


def _changed_fields(place: str, then: dict[str, Any], now: dict[str, Any]) -> Iterator[str]:
    for field in sorted(then.keys() | now.keys()):
        is_added = field not in then and place.startswith(f"{ADDED_BY_HAND}.")
        if then.get(field) != now.get(field) and not is_added:
            yield field
