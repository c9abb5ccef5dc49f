"""`ronna-campaign worlds --adversarial`: cases with changes that the looks hardly show, judged by truth."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, read_chain_until_break, theatre_time_s
from ronna_hw.host.child_process import await_end, command, run_command
from ronna_hw.host.process import shield_children
from ronna_hw.records import write_atomically
from studies.campaign import bounds
from studies.campaign.study import Cell, Sums, Table, Unit
from studies.errors import WORLD_NOT_RUN
from studies.worlds.adversary import RELOCALIZATION, AdversarialWorld, draw_adversarial_world
from studies.worlds.finished_case import LIMIT, RMS, parse_output, read_predictions, read_true_errors_mm
from studies.worlds.silence import RANKS, CaseEnding, JudgedCase, Silence, judge_case
from studies.worlds.study import CASE_FILE, LIMIT_S, RUN_FOLDER, SCRIPT_FILE
from studies.worlds.verdict import find_change_time_s

KEPT = RANKS[Silence.BEYOND]  # runs with this verdict or a worse one are kept
ROWS = 40  # of the table of cases
LONGEST_SAID = 160  # characters of a row
ENDINGS = tuple(CaseEnding)
MOST_BEYOND = 0.05  # share of the targets of undisturbed cases that chance puts beyond a 95 % limit


@dataclass(frozen=True)
class AdversarialStudy:
    """Worlds 0 to `cases` - 1 of a seed, each run in its own subfolder of `folder`.

    `quiet` are the same worlds in which nothing changes, kills included.
    """

    cases: int
    seed: int
    folder: Path
    quiet: bool = False

    @property
    def name(self) -> str:
        return "worlds-adversarial-quiet" if self.quiet else "worlds-adversarial"

    def settings(self) -> dict[str, object]:
        return {"cases": self.cases, "seed": self.seed, "quiet": self.quiet}

    def units(self) -> Sequence[Unit]:
        """Return one unit per world."""
        return [Unit(f"world {number}", 0, 1) for number in range(self.cases)]

    def run(self, unit: Unit) -> Sums:
        """Run and judge one world. Its folder contains more than the returned sums."""
        number = int(unit.condition.split()[1])
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
        """Run and judge one world in a new folder."""
        return run_adversarial_world(draw_adversarial_world(self.seed, number), folder, quiet=self.quiet)

    def place(self, number: int) -> Path:
        return self.folder / "cases" / f"{number:04d}"

    def tables(self, sums: Mapping[str, Sums]) -> list[Table]:
        """Tabulate verdicts, endings by moved body, and the worst cases with the commands to repeat them."""
        judged = {int(key.split()[1]): one for key, one in sums.items()}
        return [self._tabulate_verdicts(judged), self._tabulate_bodies(judged), self._tabulate_cases(judged)]

    def _tabulate_verdicts(self, judged: Mapping[int, Sums]) -> Table:
        counts = _count_verdicts(judged.values())
        rows: list[list[Cell]] = []
        for verdict in Silence:
            share = bounds.percent(counts[verdict], len(judged))
            rows.append([verdict.value, counts[verdict], share.value, share.text])
        noticed = _count_noticed(judged.values())
        share = bounds.percent(noticed, len(judged))
        rows.append(["refused or in doubt", noticed, share.value, share.text])
        targets, beyond = (round(sum(one[name] for one in judged.values())) for name in ("targets", "beyond"))
        happened = round(sum(one["happened"] for one in judged.values()))
        note = (
            f"{len(judged)} cases, {happened} that came as far as their change; {targets} targets reached, "
            f"{beyond} beyond their 95 % limit, told or not. {bounds.NOTE}"
        )
        return Table("Verdicts", ("verdict", "cases", "%", bounds.column("%")), rows, note)

    def _tabulate_bodies(self, judged: Mapping[int, Sums]) -> Table:
        by_bodies: dict[str, list[Sums]] = {}
        for number, one in judged.items():
            bodies = "+".join(draw_adversarial_world(self.seed, number).change.bodies)
            by_bodies.setdefault(bodies, []).append(one)
        rows: list[list[Cell]] = []
        for bodies, cases in sorted(by_bodies.items()):
            endings = [ENDINGS[round(one["ending"])] for one in cases]
            counts = _count_verdicts(cases)
            rows.append(
                [
                    bodies,
                    len(cases),
                    *(endings.count(one) for one in ENDINGS),
                    counts[Silence.BEYOND],
                    counts[Silence.SILENT],
                ]
            )
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
        case: dict[str, Any] = json.loads((self.place(number) / CASE_FILE).read_text())
        change, worst = case["world"]["change"], case["worst"]
        said = "; ".join(dict.fromkeys(filter(None, [*case["said"], case["error"]])))
        figures = [None] * 4
        if worst is not None:
            figures = [worst[one] for one in ("identifier", "error_mm", "rms_mm", "limit_mm")]
        return [
            *(number, case["verdict"], case["ending"]),
            case["changed"] + ("" if case["happened"] else " (not reached)"),
            *(change["sigmas"], change["effect_mm"], *figures),
            said if len(said) <= LONGEST_SAID else f"{said[:LONGEST_SAID]}...",
            case["repeat"],
            "<br>".join(case["script"].splitlines()),
            "<br>".join(case["commands"]),
        ]

    def list_missed_goals(self, sums: Mapping[str, Sums]) -> list[str]:
        """Describe the goals missed by these cases."""
        counts, missed = _count_verdicts(sums.values()), []
        if counts[Silence.SILENT]:
            missed.append(f"{counts[Silence.SILENT]} cases beyond twice their stated rms without a word")
        if counts[Silence.BROKEN]:
            missed.append(f"{counts[Silence.BROKEN]} cases broke off without an error of the procedure")
        if self.quiet and (noticed := _count_noticed(sums.values())):
            missed.append(f"{noticed} undisturbed cases refused or in doubt")
        beyond, targets = (sum(one[name] for one in sums.values()) for name in ("beyond", "targets"))
        if self.quiet and beyond > MOST_BEYOND * targets:
            missed.append(f"{beyond:.0f} of {targets:.0f} undisturbed targets beyond their 95 % limit")
        return missed


@dataclass(frozen=True)
class _EndedCase:
    """What a command left: its end, its run, the last journal line before a kill, and all commands."""

    ended: subprocess.CompletedProcess[str]
    run: Path
    killed_at: int | None
    commands: tuple[str, ...]


def run_adversarial_world(world: AdversarialWorld, folder: Path, *, quiet: bool = False) -> JudgedCase:
    """Run a world's case in a new folder and judge it; one that cannot be judged is broken.

    The folder keeps the fault script and the judgement, and the run where the verdict is bad.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    script = "" if quiet else world.change.script
    write_atomically(folder / SCRIPT_FILE, script.encode())
    arguments = [*world.arguments, *(() if quiet else ("--faults", str(folder / SCRIPT_FILE)))]
    arguments += ["--out", str(folder / RUN_FOLDER), "--json"]
    killed_at: int | None = None
    commands: tuple[str, ...] = (f"ronna-procedure run {' '.join(arguments)}",)
    try:
        case = _run_case(world, arguments, folder)
        killed_at, commands = case.killed_at, case.commands
        found = _judge(world, case, quiet=quiet)
    except RonnaError as error:
        found = JudgedCase(Silence.BROKEN, CaseEnding.BROKEN, (), True, (), str(error))
    mode = "--adversarial --quiet" if quiet else "--adversarial"
    content = {
        "world": asdict(world),
        "verdict": found.verdict.value,
        "ending": found.ending.value,
        "changed": "nothing" if quiet else world.change.words,
        "worst": None if found.worst is None else asdict(found.worst),
        "targets": [{**asdict(one), "verdict": one.verdict.value} for one in found.targets],
        "happened": found.happened,
        "killed_at_line": killed_at,
        "said": list(found.said),
        "error": found.error,
        "script": script,
        "commands": list(commands),
        "repeat": f"ronna-campaign worlds {mode} --seed {world.seed} --only {world.number}",
    }
    write_atomically(folder / CASE_FILE, json.dumps(content, indent=1).encode())
    if RANKS[found.verdict] < KEPT:
        shutil.rmtree(folder / RUN_FOLDER, ignore_errors=True)
    return found


def _run_case(world: AdversarialWorld, arguments: Sequence[str], folder: Path) -> _EndedCase:
    """Run a case, and resume it if it was killed. Raises STU-015 if no run was written, PRC-001."""
    ended, killed_at = _run_until_killed(world, arguments, folder)
    commands = [f"ronna-procedure run {' '.join(arguments)}"]
    run = _find_run(folder)
    if run is None:
        raise WORLD_NOT_RUN(
            f"world {world.number} ended with exit code {ended.returncode}: {ended.stderr[-300:]}"
        )
    if killed_at is not None:
        resume = ("resume", str(run), "--accept", "--json")
        commands.append(f"(killed after line {killed_at} of its journal) ronna-procedure {' '.join(resume)}")
        ended = run_command(
            f"ronna-procedure resume of world {world.number}",
            command("procedures.cli.procedure", *resume),
            LIMIT_S,
        )
    return _EndedCase(ended, run, killed_at, tuple(commands))


def _judge(world: AdversarialWorld, case: _EndedCase, *, quiet: bool) -> JudgedCase:
    """Judge a case by its journal and the truth; raises STU-015."""
    run = case.run
    return judge_case(
        read_chain_until_break(run / JOURNAL_FILE)[0].lines,
        parse_output(case.ended.stdout),
        case.ended.returncode,
        read_true_errors_mm(run),
        (read_predictions(run, RMS), read_predictions(run, LIMIT)),
        trajectories=[f"T{number + 1}" for number in range(world.targets)],
        change=(RELOCALIZATION, 0.0) if quiet else (world.change.step, world.change.after_s),
    )


def _run_until_killed(
    world: AdversarialWorld, arguments: Sequence[str], folder: Path
) -> tuple[subprocess.CompletedProcess[str], int | None]:
    """Run a case; where its program is to be killed, return the last line of its journal before."""
    name = f"ronna-procedure run of world {world.number}"
    words = command("procedures.cli.procedure", "run", *arguments)
    if world.killed_after_s is None:
        return run_command(name, words, LIMIT_S), None
    with shield_children():
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
    killed: list[int] = []
    with process:
        output, messages = await_end(name, process, LIMIT_S, _kill_once_due(world, folder, process, killed))
    ended = subprocess.CompletedProcess(words, process.returncode, output, messages)
    return ended, killed[0] if killed and process.returncode < 0 else None


def _kill_once_due(
    world: AdversarialWorld, folder: Path, process: subprocess.Popen[str], killed: list[int]
) -> Callable[[], None]:
    """Return what kills the program once its journal has come so far beyond the change."""

    def look() -> None:
        run = _find_run(folder)
        if killed or run is None:
            return
        lines = read_chain_until_break(run / JOURNAL_FILE)[0].lines
        due_s = find_change_time_s(lines, world.change.step, world.change.after_s)
        if lines and theatre_time_s(lines[-1]) >= due_s + (world.killed_after_s or 0.0):
            killed.append(len(lines))
            process.kill()

    return look


def _find_run(folder: Path) -> Path | None:
    return next((one.parent for one in sorted(folder.glob(f"{RUN_FOLDER}/*/{JOURNAL_FILE}"))), None)


def _count_verdicts(judged: Any) -> dict[Silence, int]:
    verdicts = list(Silence)
    found = [verdicts[round(one["verdict"])] for one in judged]
    return {verdict: found.count(verdict) for verdict in Silence}


def _count_noticed(judged: Any) -> int:
    return sum(ENDINGS[round(one["ending"])] in (CaseEnding.REFUSED, CaseEnding.IN_DOUBT) for one in judged)
