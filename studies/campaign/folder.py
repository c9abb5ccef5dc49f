"""Study folder, containing the ledger of finished units and the published results.

The ledger has one JSON line per unit; an interrupted study resumes from it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any, TypeGuard

import studies
from ronna_hw.bounded_input import parse_json, read_json_lines
from ronna_hw.records import canonical_json, write_atomically
from studies.campaign.study import Study, Sums, Table, Unit
from studies.errors import LEDGER_UNREADABLE, OTHER_STUDY

PROGRAM = "ronna-hw"
PACKAGES = ("procedures", "ronna_hw", "sim", "studies")  # packages that may affect results
FILE = "units.jsonl"
MOST_DAMAGED_LINES = 1000  # crashes leave a few; each is parsed in vain
RESULTS, REPORT = "results.json", "report.md"


def source_files(root: Path) -> list[Path]:
    """List the source files that affect the results, in a fixed order."""
    return [file for package in PACKAGES for file in sorted((root / package).rglob("*.py"))]


@cache
def code() -> str:
    """Return the program version and a hash of the sources, since settings omit constants in the code."""
    root, digest = Path(studies.__file__).parents[1], hashlib.sha256()
    for file in source_files(root):
        digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes())
    return f"{version(PROGRAM)}, {digest.hexdigest()[:16]}"


def head_of(study: Study) -> dict[str, object]:
    """Return the ledger's first line, with a hash of the study's name and settings."""
    settings = study.settings()
    return {
        "study": study.name,
        "fingerprint": hashlib.sha256(canonical_json({"study": study.name, **settings})).hexdigest(),
        "settings": settings,
        "code": code(),
    }


class Ledger:
    """Ledger of a study's finished units, stored in its folder.

    The first line identifies the study: results of other settings or other code are not added to.
    """

    def __init__(self, folder: Path, study: Study) -> None:
        """Open or create the ledger; raises STU-001 for a different study, STU-002 if unidentifiable."""
        self._path = folder / FILE
        self._units = {unit.key: unit for unit in study.units()}
        self.finished: dict[str, Sums] = {}
        self.damaged = 0  # lines skipped: their units are run again
        head = head_of(study)
        folder.mkdir(parents=True, exist_ok=True)
        if not self._path.exists() or not self._path.stat().st_size:
            self._append(head)
        else:
            self._read(head)

    def add(self, unit: Unit, sums: Sums) -> None:
        self.finished[unit.key] = sums
        self._append({"unit": unit.key, "sums": sums, "sha256": _hash(unit.key, sums)})

    def missing(self) -> list[Unit]:
        """Return the unfinished units in study order."""
        return [unit for key, unit in self._units.items() if key not in self.finished]

    def results(self) -> Iterator[tuple[Unit, Sums]]:
        """Yield the finished units in study order, regardless of the order of completion."""
        for key, unit in self._units.items():
            if key in self.finished:
                yield unit, self.finished[key]

    def _read(self, head: Mapping[str, object]) -> None:
        content = read_json_lines(self._path)
        whole = content[: content.rfind(b"\n") + 1]  # an unterminated line was truncated
        self.damaged = int(len(whole) < len(content))
        lines = BytesIO(whole)
        first = next(lines, b"")
        try:
            there = parse_json(first)
            if there["fingerprint"] != head["fingerprint"]:
                raise OTHER_STUDY(f"{self._path.parent} contains {_describe_difference(there, head)}")
            if (made_by := there.get("code", "unknown")) != head["code"]:
                raise OTHER_STUDY(
                    f"{self._path.parent} contains results of other code: {made_by}, now {code()}"
                )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise LEDGER_UNREADABLE(f"{self._path}: line 1 does not identify the study: {error}") from error
        kept = [first]
        for line in lines:
            if (finished := _parse_finished(line)) is not None:
                kept.append(line)
                if finished[0] in self._units:
                    self.finished[finished[0]] = finished[1]
                continue
            self.damaged += 1
            if self.damaged > MOST_DAMAGED_LINES:
                raise LEDGER_UNREADABLE(f"{self._path}: more than {MOST_DAMAGED_LINES} lines are damaged")
        if self.damaged:
            write_atomically(self._path, b"".join(kept))

    def _append(self, line: Mapping[str, object]) -> None:
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            error.filename = error.filename or str(self._path)  # errors while writing do not name the file
            raise


def _hash(key: str, sums: Sums) -> str:
    return hashlib.sha256(json.dumps([key, sums], sort_keys=True).encode()).hexdigest()


def _parse_finished(line: bytes) -> tuple[str, Sums] | None:
    """Parse a ledger line into unit and sums, or return None if it is damaged or its hash is wrong."""
    try:
        content = parse_json(line)
        key, sums = content["unit"], content["sums"]
        intact = content["sha256"] == _hash(key, sums)
    except (ValueError, KeyError, TypeError):
        return None
    return (key, sums) if intact and isinstance(key, str) and _are_sums(sums) else None


def _are_sums(found: Any) -> TypeGuard[Sums]:
    return isinstance(found, dict) and all(isinstance(value, int | float) for value in found.values())


def _describe_difference(there: Any, head: Mapping[str, Any]) -> str:
    if there["study"] != head["study"]:
        return f"the study {there['study']}, not {head['study']}"
    # as in the file: a list for a tuple, a name for an enum member
    before, now = there.get("settings", {}), json.loads(json.dumps(head["settings"]))
    differ = [
        f"{name} {before.get(name)!r}, now {now.get(name)!r}"
        for name in sorted({*before, *now})
        if before.get(name) != now.get(name)
    ]
    return f"a study with other settings: {'; '.join(differ)}"


def publish(
    folder: Path,
    title: str,
    settings: Mapping[str, object],
    tables: Sequence[Table],
    plots: Mapping[str, bytes],
) -> Path:
    """Write all results into `folder` and return the path of the report."""
    document = {
        "study": title,
        "settings": dict(settings),
        "code": code(),
        "tables": [table.document() for table in tables],
        "plots": sorted(plots),
    }
    write_atomically(folder / RESULTS, json.dumps(document, indent=1, allow_nan=False).encode())
    for table in tables:
        write_atomically(folder / f"{_file_name(table.title)}.csv", table.csv().encode())
    for name, png in plots.items():
        write_atomically(folder / name, png)
    pictures = "".join(f"![{name}]({name})\n\n" for name in sorted(plots))
    listed = ", ".join(f"{key} {json.dumps(value)}" for key, value in settings.items())
    text = (
        f"# {title}\n\n{listed}; code {code()}\n\n"
        + "\n".join(table.markdown() for table in tables)
        + f"\n{pictures}"
    )
    write_atomically(folder / REPORT, text.encode())
    return folder / REPORT


def _file_name(title: str) -> str:
    return "-".join("".join(c if c.isalnum() else " " for c in title.lower()).split())
