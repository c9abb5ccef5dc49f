"""`ronna-campaign worlds`: random worlds, run by command as a user would, and judged against ground truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from ronna_hw.errors import EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, read_chain_until_break
from ronna_hw.host.child_process import command, run_command
from ronna_hw.records import write_atomically
from studies.campaign import bounds
from studies.campaign.study import Cell, Sums, Table, Unit
from studies.errors import WORLD_NOT_RUN
from studies.worlds.finished_case import (
    FINISHED,
    parse_output,
    read_error_text,
    read_predictions,
    read_true_errors_mm,
)
from studies.worlds.verdict import (
    RANKS,
    JudgedTarget,
    Judgement,
    WorldVerdict,
    judge,
    limits_used_mm,
    worst_of,
)
from studies.worlds.world import MINI, DrawnWorld, draw_world

LIMIT_S = 900.0  # host time of a case, on a busy machine
BY_THE_PROCEDURE = (EXIT_REFUSED, EXIT_SAFETY_STOP)  # neither a lost link nor a failed device
SCRIPT_FILE, CASE_FILE, RUN_FOLDER = "faults.txt", "case.json", "run"
KEPT = RANKS[WorldVerdict.FALSE_FINDING]  # runs with this verdict or a worse one are kept
WORST = 15  # rows of the table
MOST_SILENT = 0.05  # share of cases with an error beyond its limit and no finding
SILENT = (WorldVerdict.SILENT, WorldVerdict.SILENT2)
LONGEST_WARNING = 100  # characters of a row


@dataclass(frozen=True)
class WorldsStudy:
    """Worlds 0 to `cases` - 1 of a seed, each run in its own subfolder of `folder`."""

    cases: int
    seed: int
    folder: Path
    scene: str = MINI
    quiet: bool = False

    @property
    def name(self) -> str:
        return "worlds-quiet" if self.quiet else "worlds"

    def settings(self) -> dict[str, object]:
        return {"cases": self.cases, "seed": self.seed, "scene": self.scene, "quiet": self.quiet}

    def units(self) -> Sequence[Unit]:
        """Return one unit per world."""
        return [Unit(f"world {number}", 0, 1) for number in range(self.cases)]

    def run(self, unit: Unit) -> Sums:
        """Run and judge one world. Its folder contains more than the returned sums."""
        number = int(unit.condition.split()[1])
        found = run_world(self.world(number), self.place(number))
        worst = found.worst
        sums = {"verdict": float(RANKS[found.verdict]), "happened": float(found.happened)}
        return sums if worst is None else {**sums, "error_mm": worst.error_mm, "limit_mm": worst.limit_mm}

    def world(self, number: int) -> DrawnWorld:
        return draw_world(self.seed, number, self.scene, quiet=self.quiet)

    def place(self, number: int) -> Path:
        return self.folder / "cases" / f"{number:04d}"

    def tables(self, sums: Mapping[str, Sums]) -> list[Table]:
        """Tabulate the share of each verdict, and the worst cases."""
        judged = {int(key.split()[1]): one for key, one in sums.items()}
        return [self._tabulate_summary(judged), self._tabulate_worst(judged)]

    def _tabulate_summary(self, judged: Mapping[int, Sums]) -> Table:
        counts = _count_verdicts(judged.values())
        rows: list[list[Cell]] = []
        for verdict in WorldVerdict:
            share = bounds.percent(counts[verdict], len(judged))
            rows.append([verdict.value, counts[verdict], share.value, share.text])
        happened = round(sum(one["happened"] for one in judged.values()))
        note = f"{len(judged)} cases, {happened} with a change that was reached. {bounds.NOTE}"
        return Table("Verdicts", ("verdict", "cases", "%", bounds.column("%")), rows, note)

    def _tabulate_worst(self, judged: Mapping[int, Sums]) -> Table:
        columns = (
            *("world", "verdict", "scene seed", "change", "moment", "target", "error mm", "limit mm"),
            *("said", "repeat"),
        )
        order = sorted(judged, key=lambda number: _badness(judged[number]), reverse=True)
        rows = [self._make_row(number) for number in order[:WORST]]
        return Table(
            "Worst cases", columns, rows, f"Everything of a case is in its folder below {self.folder}."
        )

    def _make_row(self, number: int) -> list[Cell]:
        case: dict[str, Any] = json.loads((self.place(number) / CASE_FILE).read_text())
        world = self.world(number)
        targets = [
            JudgedTarget(**{one.name: row[one.name] for one in fields(JudgedTarget)})
            for row in case["targets"]
        ]
        worst = worst_of(targets)
        change = world.change
        warnings = "; ".join(dict.fromkeys([*case["said"], case["error"]])).strip("; ")
        options = f"--seed {self.seed} --scene {self.scene}{' --quiet' if self.quiet else ''}"
        return [
            *(number, case["verdict"], world.scene_seed),
            "none" if change is None else change.words,
            "" if change is None else change.moment + ("" if case["happened"] else " (not reached)"),
            *((None, None, None) if worst is None else (worst.identifier, worst.error_mm, worst.limit_mm)),
            warnings if len(warnings) <= LONGEST_WARNING else f"{warnings[:LONGEST_WARNING]}...",
            f"ronna-campaign worlds {options} --only {number}",
        ]

    def list_missed_goals(self, sums: Mapping[str, Sums]) -> list[str]:
        """Describe the goals missed by these cases."""
        counts = _count_verdicts(sums.values())
        silent = sum(counts[one] for one in SILENT)
        missed = []
        if self.quiet:
            if counts[WorldVerdict.FALSE_FINDING] or counts[WorldVerdict.REFUSED]:
                missed.append("quiet cases with a finding or a refusal: expected none")
        else:
            if silent > MOST_SILENT * len(sums):
                missed.append(
                    f"{silent} of {len(sums)} cases beyond a limit unseen: at most {MOST_SILENT:.0%}"
                )
            if counts[WorldVerdict.SILENT2]:
                count = counts[WorldVerdict.SILENT2]
                missed.append(f"{count} cases beyond twice a limit unseen: expected none")
            if counts[WorldVerdict.FALSE_FINDING]:
                count = counts[WorldVerdict.FALSE_FINDING]
                missed.append(f"{count} findings before any change: expected none")
        if counts[WorldVerdict.NO_VERDICT]:
            missed.append(f"{counts[WorldVerdict.NO_VERDICT]} cases broke off without a verdict")
        return missed


def run_world(world: DrawnWorld, folder: Path) -> Judgement:
    """Run a world's case in a new folder and judge it; raises STU-015 if no run was written.

    The folder keeps the fault script and the judgement, and the run where the verdict is bad.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    arguments = [*world.arguments, "--out", str(folder / RUN_FOLDER), "--json"]
    if world.change is not None:
        write_atomically(folder / SCRIPT_FILE, world.change.script.encode())
        arguments += ["--faults", str(folder / SCRIPT_FILE)]
    name = f"ronna-procedure run of world {world.number}"
    ended = run_command(name, command("procedures.cli.procedure", "run", *arguments), LIMIT_S)
    run = next(iter(sorted(folder.glob(f"{RUN_FOLDER}/*/{JOURNAL_FILE}"))), None)
    if run is None:
        raise WORLD_NOT_RUN(
            f"world {world.number} ended with exit code {ended.returncode}: {ended.stderr[-300:]}"
        )
    chain, _ = read_chain_until_break(run)
    printed = parse_output(ended.stdout)
    found = judge(
        chain.lines,
        read_true_errors_mm(run.parent),
        limits_used_mm(chain.lines, read_predictions(run.parent)),
        trajectories=[f"T{number + 1}" for number in range(world.targets)],
        change=None if world.change is None else (world.change.step, world.change.after_s),
        done=printed.get("outcome") in FINISHED,
        error=read_error_text(printed) if ended.returncode in BY_THE_PROCEDURE else "",
    )
    write_atomically(folder / CASE_FILE, json.dumps(document(world, found), indent=1).encode())
    if RANKS[found.verdict] < KEPT:
        shutil.rmtree(folder / RUN_FOLDER)
    return found


def document(world: DrawnWorld, found: Judgement) -> dict[str, Any]:
    """Return a world and its judgement as plain data."""
    return {
        "world": asdict(world),
        "verdict": found.verdict.value,
        "targets": [{**asdict(one), "verdict": one.verdict.value} for one in found.targets],
        "happened": found.happened,
        "said": list(found.said),
        "error": found.error,
    }


def _count_verdicts(judged: Any) -> dict[WorldVerdict, int]:
    verdicts = list(WorldVerdict)
    found = [verdicts[round(one["verdict"])] for one in judged]
    return {verdict: found.count(verdict) for verdict in WorldVerdict}


def _badness(one: Sums) -> tuple[float, float]:
    limit_mm = one.get("limit_mm", 0.0)
    return one["verdict"], one.get("error_mm", 0.0) / limit_mm if limit_mm else 0.0
