"""Studies of whole cases, run by command as a user would in a folder each, and their verdicts."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any, ClassVar, TypeVar

from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.records import write_atomically
from studies.campaign import bounds
from studies.campaign.study import Cell, Study, Sums, Table, Unit
from studies.errors import WORLD_NOT_RUN
from studies.worlds.adversary import AdversarialWorld
from studies.worlds.silence import JudgedCase
from studies.worlds.verdict import Judgement
from studies.worlds.world import DrawnWorld

LIMIT_S = 900.0  # host time of a case, on a busy machine
SCRIPT_FILE, CASE_FILE, RUN_FOLDER = "faults.txt", "case.json", "run"
Verdict = TypeVar("Verdict", bound=StrEnum)


@dataclass(frozen=True)
class CasesStudy(Study):
    """Worlds 0 to `cases` - 1 of a seed, each run in its own subfolder of `folder`."""

    cases: int
    seed: int
    folder: Path
    verdicts: ClassVar[type[StrEnum]]  # from best to worst

    def settings(self) -> dict[str, object]:
        return {name: value for name, value in asdict(self).items() if name != "folder"}

    def units(self) -> Sequence[Unit]:
        return [Unit(f"world {number}", 0, 1) for number in range(self.cases)]

    def place(self, number: int) -> Path:
        return self.folder / "cases" / f"{number:04d}"

    def read_case(self, number: int) -> dict[str, Any]:
        """Return what `keep_case` wrote of a world."""
        content: dict[str, Any] = json.loads((self.place(number) / CASE_FILE).read_text())
        return content

    def tabulate_verdicts(self, judged: Iterable[Sums], note: str, *more: tuple[str, int]) -> Table:
        """Tabulate the share of each verdict, and of `more` by name and number of cases."""
        counts = count_verdicts(self.verdicts, judged)
        rows: list[Sequence[Cell]] = []
        for name, count in (*((one.value, number) for one, number in counts.items()), *more):
            share = bounds.percent(count, sum(counts.values()))
            rows.append([name, count, share.value, share.text])
        return Table("Verdicts", ("verdict", "cases", "%", bounds.column("%")), rows, f"{note} {bounds.NOTE}")


def number_of(condition: str) -> int:
    return int(condition.split()[1])


def count_verdicts(verdicts: type[Verdict], judged: Iterable[Mapping[str, float]]) -> dict[Verdict, int]:
    order = list(verdicts)
    found = [order[round(one["verdict"])] for one in judged]
    return {verdict: found.count(verdict) for verdict in order}


def shorten(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]}..."


def renew_folder(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)


def find_run(folder: Path) -> Path | None:
    """Return the run that a case has written in its folder so far."""
    return next((one.parent for one in sorted(folder.glob(f"{RUN_FOLDER}/*/{JOURNAL_FILE}"))), None)


def require_run(folder: Path, number: int, ended: CompletedProcess[str]) -> Path:
    """Return the run of a world whose case has ended; raises STU-015 if there is none."""
    if (run := find_run(folder)) is None:
        raise WORLD_NOT_RUN(f"world {number} ended with exit code {ended.returncode}: {ended.stderr[-300:]}")
    return run


def describe_case(world: DrawnWorld | AdversarialWorld, found: Judgement | JudgedCase) -> dict[str, Any]:
    return {
        "world": asdict(world),
        "verdict": found.verdict.value,
        "targets": [{**asdict(one), "verdict": one.verdict.value} for one in found.targets],
        "happened": found.happened,
        "said": list(found.said),
        "error": found.error,
    }


def keep_case(folder: Path, content: Mapping[str, object], *, with_run: bool) -> None:
    """Write the judgement of a case, and remove its run unless it is to be kept."""
    write_atomically(folder / CASE_FILE, json.dumps(content, indent=1).encode())
    if not with_run:
        shutil.rmtree(folder / RUN_FOLDER, ignore_errors=True)
