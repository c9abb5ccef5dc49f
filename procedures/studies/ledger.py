"""The record of finished units, one JSON line each, from which an interrupted study resumes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from procedures.studies.errors import LedgerUnreadable, OtherStudy
from procedures.studies.unit import Study, Sums, Unit
from ronna_hw.bounded_input import parse_json, read_json_lines
from ronna_hw.records import canonical_json

FILE = "units.jsonl"


def fingerprint(study: Study) -> str:
    """Hash of everything the results of a study depend on."""
    return hashlib.sha256(canonical_json({"study": study.name, **study.parameters()})).hexdigest()


class Ledger:
    """Finished units of one study in a folder. The first line says which study it is."""

    def __init__(self, folder: Path, study: Study) -> None:
        """Open or start it; raises STU-001 for another study, STU-002 when it is damaged."""
        self._path = folder / FILE
        self._units = {unit.key: unit for unit in study.units()}
        self.finished: dict[str, Sums] = {}
        head = {"study": study.name, "fingerprint": fingerprint(study), "parameters": study.parameters()}
        folder.mkdir(parents=True, exist_ok=True)
        if not self._path.exists() or not self._path.stat().st_size:
            self._append(head)
        else:
            self._read(head)

    def add(self, unit: Unit, sums: Sums) -> None:
        """Record a finished unit."""
        self.finished[unit.key] = sums
        self._append({"unit": unit.key, "sums": sums})

    def missing(self) -> list[Unit]:
        """Units still to be run, in the order of the study."""
        return [unit for key, unit in self._units.items() if key not in self.finished]

    def results(self) -> Iterator[tuple[Unit, Sums]]:
        """Finished units in the order of the study, whatever order they finished in."""
        for key, unit in self._units.items():
            if key in self.finished:
                yield unit, self.finished[key]

    def _read(self, head: Mapping[str, object]) -> None:
        lines = read_json_lines(self._path).decode().split("\n")
        try:
            there = parse_json(lines[0])
            whole = [parse_json(line) for line in lines[1:-1]]  # a line without an end was truncated
            if there["fingerprint"] != head["fingerprint"]:
                raise OtherStudy(f"{self._path.parent} holds a {there['study']} study with other parameters")
            self.finished = {line["unit"]: line["sums"] for line in whole if line["unit"] in self._units}
        except (ValueError, KeyError, TypeError) as error:
            raise LedgerUnreadable(f"{self._path} is damaged: {error}") from error
        if lines[-1]:
            self._path.write_text("\n".join([*lines[:-1], ""]), encoding="utf-8")

    def _append(self, line: Mapping[str, object]) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
