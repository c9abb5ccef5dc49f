"""`ronna-campaign worlds --adversarial`: cases with changes that the looks hardly show, judged by truth."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar

from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, read_chain_until_break, theatre_time_s
from ronna_hw.host.child_process import await_end, command, run_command, start_command
from ronna_hw.records import write_atomically
from ronna_hw.text import format_count
from studies.campaign.study import Cell, Sums, Table, Unit
from studies.worlds.adversary import RELOCALIZATION, AdversarialWorld, draw_adversarial_world
from studies.worlds.cases import (
    LIMIT_S,
    RUN_FOLDER,
    SCRIPT_FILE,
    CasesStudy,
    count_verdicts,
    describe_case,
    find_run,
    keep_case,
    number_of,
    renew_folder,
    require_run,
    shorten,
)
from studies.worlds.finished_case import LIMIT, RMS, parse_output, read_predictions, read_true_errors_mm
from studies.worlds.silence import RANKS, CaseEnding, JudgedCase, Silence, judge_case
from studies.worlds.verdict import find_change_time_s

KEPT = RANKS[Silence.BEYOND]  # runs with this verdict or a worse one are kept
ROWS = 40  # of the table of cases
LONGEST_SAID = 160  # characters of a row
ENDINGS = tuple(CaseEnding)
MOST_BEYOND = 0.05  # share of the targets of undisturbed cases that chance puts beyond a 95 % limit


@dataclass(frozen=True)
class AdversarialStudy(CasesStudy):
    """Worlds with a change that the looks hardly show.

    `quiet` are the same worlds in which nothing changes, kills included.
    """

    quiet: bool = False
    verdicts: ClassVar = Silence

    @property
    def name(self) -> str:
        return "worlds-adversarial-quiet" if self.quiet else "worlds-adversarial"

    def run(self, unit: Unit) -> Sums:
        number = number_of(unit.condition)
        found = self.run_world(number, self.place(number))
        beyond = [one.error_mm > one.limit_mm for one in found.targets]
        return {
            "verdict": float(RANKS[found.verdict]),
            "ending": float(ENDINGS.index(found.ending)),
            "happened": float(found.happened),
            "targets": float(len(beyond)),
            "beyond": float(sum(beyond)),
            "ratio": max((one.error_mm / one.rms_mm for one in found.targets if one.rms_mm), default=0.0),
        }

    def run_world(self, number: int, folder: Path) -> JudgedCase:
        return run_adversarial_world(draw_adversarial_world(self.seed, number), folder, quiet=self.quiet)

    def tables(self, sums: Mapping[str, Sums]) -> list[Table]:
        """Tabulate verdicts, endings by moved body, and the worst cases with the commands to repeat them."""
        judged = {number_of(key): one for key, one in sums.items()}
        targets, beyond, happened = (
            round(sum(one[name] for one in judged.values())) for name in ("targets", "beyond", "happened")
        )
        note = (
            f"{format_count(len(judged), 'case')}, {happened} that came as far as their change; {targets} "
            f"targets reached, {beyond} beyond their 95 % limit, told or not."
        )
        noticed = ("refused or in doubt", _count_noticed(judged.values()))
        verdicts = self.tabulate_verdicts(judged.values(), note, noticed)
        return [verdicts, self._tabulate_bodies(judged), self._tabulate_cases(judged)]

    def _tabulate_bodies(self, judged: Mapping[int, Sums]) -> Table:
        by_bodies: dict[str, list[Sums]] = {}
        for number, one in judged.items():
            bodies = "+".join(draw_adversarial_world(self.seed, number).change.bodies)
            by_bodies.setdefault(bodies, []).append(one)
        rows: list[list[Cell]] = []
        for bodies, cases in sorted(by_bodies.items()):
            endings = [ENDINGS[round(one["ending"])] for one in cases]
            counts = count_verdicts(Silence, cases)
            ended = (endings.count(one) for one in ENDINGS)
            rows.append([bodies, len(cases), *ended, counts[Silence.BEYOND], counts[Silence.SILENT]])
        columns = ("moved", "cases", *(one.value for one in ENDINGS), "beyond", "silent")
        return Table("By what is moved", columns, rows, "How the cases ended, and how many without a word.")

    def _tabulate_cases(self, judged: Mapping[int, Sums]) -> Table:
        columns = (
            *("world", "verdict", "ended", "changed", "sigmas", "effect mm", "target", "error mm", "rms mm"),
            *("95 % mm", "said", "repeat", "fault script", "command"),
        )
        order = sorted(
            judged, key=lambda number: (judged[number]["verdict"], judged[number]["ratio"]), reverse=True
        )
        rows = [self._make_row(number) for number in order[:ROWS]]
        note = f"Everything of a case is in its folder below {self.folder}."
        return Table("Worst cases", columns, rows, note)

    def _make_row(self, number: int) -> list[Cell]:
        case = self.read_case(number)
        change, worst = case["world"]["change"], case["worst"]
        said = "; ".join(dict.fromkeys(filter(None, [*case["said"], case["error"]])))
        figures = [None] * 4
        if worst is not None:
            figures = [worst[one] for one in ("identifier", "error_mm", "rms_mm", "limit_mm")]
        return [
            *(number, case["verdict"], case["ending"]),
            case["changed"] + ("" if case["happened"] else " (not reached)"),
            *(change["sigmas"], change["effect_mm"], *figures),
            shorten(said, LONGEST_SAID),
            case["repeat"],
            "<br>".join(case["script"].splitlines()),
            "<br>".join(case["commands"]),
        ]

    def list_missed_goals(self, sums: Mapping[str, Sums]) -> list[str]:
        counts, missed = count_verdicts(Silence, sums.values()), []
        if counts[Silence.SILENT]:
            missed.append(
                f"{format_count(counts[Silence.SILENT], 'case')} beyond twice their stated rms without a word"
            )
        if counts[Silence.BROKEN]:
            missed.append(
                f"{format_count(counts[Silence.BROKEN], 'case')} broke off without an error of the procedure"
            )
        if self.quiet and (noticed := _count_noticed(sums.values())):
            missed.append(f"{noticed} undisturbed cases refused or in doubt")
        beyond, targets = (sum(one[name] for one in sums.values()) for name in ("beyond", "targets"))
        if self.quiet and beyond > MOST_BEYOND * targets:
            missed.append(f"{beyond:.0f} of {targets:.0f} undisturbed targets beyond their 95 % limit")
        return missed


def run_adversarial_world(world: AdversarialWorld, folder: Path, *, quiet: bool = False) -> JudgedCase:
    """Run a world's case in a new folder and judge it; one that cannot be judged is broken.

    The folder keeps the fault script and the judgement, and the run where the verdict is bad.
    """
    renew_folder(folder)
    script = "" if quiet else world.change.script
    write_atomically(folder / SCRIPT_FILE, script.encode())
    arguments = [*world.arguments, *(() if quiet else ("--faults", str(folder / SCRIPT_FILE)))]
    arguments += ["--out", str(folder / RUN_FOLDER), "--json"]
    killed_at: int | None = None
    commands: tuple[str, ...] = (f"ronna-procedure run {' '.join(arguments)}",)
    try:
        ended, run, killed_at, commands = _run_case(world, arguments, folder)
        found = judge_case(
            read_chain_until_break(run / JOURNAL_FILE)[0].lines,
            parse_output(ended.stdout),
            ended.returncode,
            read_true_errors_mm(run),
            (read_predictions(run, RMS), read_predictions(run, LIMIT)),
            trajectories=[f"T{number + 1}" for number in range(world.targets)],
            change=(RELOCALIZATION, 0.0) if quiet else (world.change.step, world.change.after_s),
        )
    except RonnaError as error:
        found = JudgedCase(Silence.BROKEN, CaseEnding.BROKEN, (), True, (), str(error))
    mode = "--adversarial --quiet" if quiet else "--adversarial"
    content = {
        **describe_case(world, found),
        "ending": found.ending.value,
        "changed": "nothing" if quiet else world.change.words,
        "worst": None if found.worst is None else asdict(found.worst),
        "killed_at_line": killed_at,
        "script": script,
        "commands": list(commands),
        "repeat": f"ronna-campaign worlds {mode} --seed {world.seed} --only {world.number}",
    }
    keep_case(folder, content, with_run=RANKS[found.verdict] >= KEPT)
    return found


def _run_case(
    world: AdversarialWorld, arguments: Sequence[str], folder: Path
) -> tuple[subprocess.CompletedProcess[str], Path, int | None, tuple[str, ...]]:
    """Run a case, and resume it if it was killed. Raises STU-015 if no run was written, PRC-001.

    Returns its end, its run, the last journal line before a kill, and all commands.
    """
    ended, killed_at = _run_until_killed(world, arguments, folder)
    commands = [f"ronna-procedure run {' '.join(arguments)}"]
    run = require_run(folder, world.number, ended)
    if killed_at is not None:
        resume = ("resume", str(run), "--accept", "--json")
        commands.append(f"(killed after line {killed_at} of its journal) ronna-procedure {' '.join(resume)}")
        name = f"ronna-procedure resume of world {world.number}"
        ended = run_command(name, command("procedures.cli.procedure", *resume), LIMIT_S)
    return ended, run, killed_at, tuple(commands)


def _run_until_killed(
    world: AdversarialWorld, arguments: Sequence[str], folder: Path
) -> tuple[subprocess.CompletedProcess[str], int | None]:
    """Run a case; where its program is to be killed, return the last line of its journal before."""
    name = f"ronna-procedure run of world {world.number}"
    words = command("procedures.cli.procedure", "run", *arguments)
    if world.killed_after_s is None:
        return run_command(name, words, LIMIT_S), None
    killed: list[int] = []
    with start_command(words) as process:
        output, messages = await_end(name, process, LIMIT_S, _kill_once_due(world, folder, process, killed))
    ended = subprocess.CompletedProcess(words, process.returncode, output, messages)
    return ended, killed[0] if killed and process.returncode < 0 else None


def _kill_once_due(
    world: AdversarialWorld, folder: Path, process: subprocess.Popen[str], killed: list[int]
) -> Callable[[], None]:
    """Return what kills the program once its journal has come so far beyond the change."""

    def look() -> None:
        run = find_run(folder)
        if killed or run is None:
            return
        lines = read_chain_until_break(run / JOURNAL_FILE)[0].lines
        due_s = find_change_time_s(lines, world.change.step, world.change.after_s)
        if lines and theatre_time_s(lines[-1]) >= due_s + (world.killed_after_s or 0.0):
            killed.append(len(lines))
            process.kill()

    return look


def _count_noticed(judged: Iterable[Sums]) -> int:
    return sum(ENDINGS[round(one["ending"])] in (CaseEnding.REFUSED, CaseEnding.IN_DOUBT) for one in judged)
