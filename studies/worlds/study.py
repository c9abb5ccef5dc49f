"""`ronna-campaign worlds`: random worlds, run by command as a user would, and judged against ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

from ronna_hw.errors import EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, read_chain_until_break
from ronna_hw.host.child_process import command, run_command
from ronna_hw.records import write_atomically
from ronna_hw.text import format_count
from studies.campaign.study import Cell, Sums, Table, Unit
from studies.worlds.cases import (
    LIMIT_S,
    RUN_FOLDER,
    SCRIPT_FILE,
    CasesStudy,
    count_verdicts,
    describe_case,
    keep_case,
    number_of,
    renew_folder,
    require_run,
    shorten,
)
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

BY_THE_PROCEDURE = (EXIT_REFUSED, EXIT_SAFETY_STOP)  # neither a lost link nor a failed device
KEPT = RANKS[WorldVerdict.FALSE_FINDING]  # runs with this verdict or a worse one are kept
WORST = 15  # rows of the table
MOST_SILENT = 0.05  # share of cases with an error beyond its limit and no finding
SILENT = (WorldVerdict.SILENT, WorldVerdict.SILENT2)
LONGEST_WARNING = 100  # characters of a row


@dataclass(frozen=True)
class WorldsStudy(CasesStudy):
    """Worlds with one random change in each, or none."""

    scene: str = MINI
    quiet: bool = False
    verdicts: ClassVar = WorldVerdict

    @property
    def name(self) -> str:
        return "worlds-quiet" if self.quiet else "worlds"

    def run(self, unit: Unit) -> Sums:
        number = number_of(unit.condition)
        found = self.run_world(number, self.place(number))
        worst = found.worst
        sums = {"verdict": float(RANKS[found.verdict]), "happened": float(found.happened)}
        return sums if worst is None else {**sums, "error_mm": worst.error_mm, "limit_mm": worst.limit_mm}

    def run_world(self, number: int, folder: Path) -> Judgement:
        return run_world(self.world(number), folder)

    def world(self, number: int) -> DrawnWorld:
        return draw_world(self.seed, number, self.scene, quiet=self.quiet)

    def tables(self, sums: Mapping[str, Sums]) -> list[Table]:
        judged = {number_of(key): one for key, one in sums.items()}
        happened = round(sum(one["happened"] for one in judged.values()))
        note = f"{format_count(len(judged), 'case')}, {happened} with a change that was reached."
        order = sorted(judged, key=lambda number: _badness(judged[number]), reverse=True)
        worst = Table(
            "Worst cases",
            (
                *("world", "verdict", "scene seed", "change", "moment", "target", "error mm", "limit mm"),
                *("said", "repeat"),
            ),
            [self._make_row(number) for number in order[:WORST]],
            f"Everything of a case is in its folder below {self.folder}.",
        )
        return [self.tabulate_verdicts(judged.values(), note), worst]

    def _make_row(self, number: int) -> list[Cell]:
        case = self.read_case(number)
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
            shorten(warnings, LONGEST_WARNING),
            f"ronna-campaign worlds {options} --only {number}",
        ]

    def list_missed_goals(self, sums: Mapping[str, Sums]) -> list[str]:
        counts = count_verdicts(WorldVerdict, sums.values())
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
                missed.append(f"{format_count(count, 'case')} beyond twice a limit unseen: expected none")
            if counts[WorldVerdict.FALSE_FINDING]:
                count = counts[WorldVerdict.FALSE_FINDING]
                missed.append(f"{format_count(count, 'finding')} before any change: expected none")
        if counts[WorldVerdict.NO_VERDICT]:
            missed.append(
                f"{format_count(counts[WorldVerdict.NO_VERDICT], 'case')} broke off without a verdict"
            )
        return missed


def run_world(world: DrawnWorld, folder: Path) -> Judgement:
    """Run a world's case in a new folder and judge it; raises STU-015 if no run was written.

    The folder keeps the fault script and the judgement, and the run where the verdict is bad.
    """
    renew_folder(folder)
    arguments = [*world.arguments, "--out", str(folder / RUN_FOLDER), "--json"]
    if world.change is not None:
        write_atomically(folder / SCRIPT_FILE, world.change.script.encode())
        arguments += ["--faults", str(folder / SCRIPT_FILE)]
    name = f"ronna-procedure run of world {world.number}"
    ended = run_command(name, command("procedures.cli.procedure", "run", *arguments), LIMIT_S)
    run = require_run(folder, world.number, ended)
    lines = read_chain_until_break(run / JOURNAL_FILE)[0].lines
    printed = parse_output(ended.stdout)
    found = judge(
        lines,
        read_true_errors_mm(run),
        limits_used_mm(lines, read_predictions(run)),
        trajectories=[f"T{number + 1}" for number in range(world.targets)],
        change=None if world.change is None else (world.change.step, world.change.after_s),
        done=printed.get("outcome") in FINISHED,
        error=read_error_text(printed) if ended.returncode in BY_THE_PROCEDURE else "",
    )
    keep_case(folder, describe_case(world, found), with_run=RANKS[found.verdict] >= KEPT)
    return found


def _badness(one: Sums) -> tuple[float, float]:
    limit_mm = one.get("limit_mm", 0.0)
    return one["verdict"], one.get("error_mm", 0.0) / limit_mm if limit_mm else 0.0
