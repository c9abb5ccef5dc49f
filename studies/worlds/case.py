"""One world carried out as a user would, by commands of its own, and judged."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ronna_hw.errors import EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, chain_until_broken
from ronna_hw.evidence.manifest import RECORDS_FOLDER
from ronna_hw.host.child_process import command, finished_command
from ronna_hw.records import read_record, write_whole
from studies.errors import WorldNotRun
from studies.worlds.verdict import RANKS, Judgement, Verdict, judge, limits_used_mm
from studies.worlds.world import World

LIMIT_S = 900.0  # host time of a case, on a busy machine
VERIFY_LIMIT_S = 120.0
NO_TARGET = "SIM-006"
BY_THE_PROCEDURE = (EXIT_REFUSED, EXIT_SAFETY_STOP)  # not a link that was lost or a device that failed
FINISHED = ("done", "in doubt")  # outcomes of a case whose steps were all done
SCRIPT_FILE, CASE_FILE, RUN_FOLDER = "faults.txt", "case.json", "run"
KEPT = RANKS[Verdict.FALSE_FINDING]  # from here on the run is worth reading


def carry_out(world: World, folder: Path) -> Judgement:
    """Run the case of a world in a new folder and judge it; raises STU-015 when no run was written.

    The folder keeps the fault script and the judgement, and the run where the verdict is bad.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    arguments = [*world.arguments, "--out", str(folder / RUN_FOLDER), "--json"]
    if world.change is not None:
        write_whole(folder / SCRIPT_FILE, world.change.script.encode())
        arguments += ["--faults", str(folder / SCRIPT_FILE)]
    name = f"ronna-procedure run of world {world.number}"
    ended = finished_command(name, command("procedures.cli.procedure", "run", *arguments), LIMIT_S)
    run = next(iter(sorted(folder.glob(f"{RUN_FOLDER}/*/{JOURNAL_FILE}"))), None)
    if run is None:
        raise WorldNotRun(
            f"world {world.number} ended with exit code {ended.returncode}: {ended.stderr[-300:]}"
        )
    chain, _ = chain_until_broken(run)
    found = judge(
        chain.lines,
        _true_errors_mm(run.parent),
        limits_used_mm(chain.lines, _predictions(run.parent)),
        trajectories=[f"T{number + 1}" for number in range(world.targets)],
        change=None if world.change is None else (world.change.step, world.change.after_s),
        done=_printed(ended.stdout).get("outcome") in FINISHED,
        error=_error(ended.stdout) if ended.returncode in BY_THE_PROCEDURE else "",
    )
    write_whole(folder / CASE_FILE, json.dumps(document(world, found), indent=1).encode())
    if RANKS[found.verdict] < KEPT:
        shutil.rmtree(folder / RUN_FOLDER)
    return found


def document(world: World, found: Judgement) -> dict[str, Any]:
    """A judged world as plain data."""
    return {
        "world": asdict(world),
        "verdict": found.verdict.value,
        "targets": [{**asdict(one), "verdict": one.verdict.value} for one in found.targets],
        "happened": found.happened,
        "said": list(found.said),
        "error": found.error,
    }


def _true_errors_mm(run: Path) -> dict[str, float]:
    """True errors of the targets that were reached."""
    ended = finished_command(
        "ronna-sim verify", command("sim.cli", "verify", str(run), "--json"), VERIFY_LIMIT_S
    )
    if not ended.stdout and NO_TARGET not in ended.stderr:  # else no instrument reached a target
        raise WorldNotRun(f"{run.name} cannot be judged: {ended.stderr[-300:]}")
    targets = json.loads(ended.stdout)["targets"] if ended.stdout else []
    return {str(one["id"]): float(one["application_error_mm"]) for one in targets}


def _predictions(run: Path) -> dict[str, dict[str, float]]:
    """The 95 % limits of each record that predicts errors, by record and target."""
    found: dict[str, dict[str, float]] = {}
    for path in sorted((run / RECORDS_FOLDER).glob("*.json")):
        record = read_record(path)
        predicted: Any = record.payload.get("predictions") or ()
        found[record.identifier] = {str(one["target"]): float(one["limit_mm"]) for one in predicted}
    return found


def _printed(output: str) -> dict[str, Any]:
    """The object that a run printed; empty if it printed none."""
    try:
        printed: dict[str, Any] = json.loads(output)
    except ValueError:
        return {}
    return printed


def _error(output: str) -> str:
    """Code and message of the error that ended a run, empty without one."""
    error = _printed(output).get("error") or {}
    return f"{error.get('code')}: {error.get('what')}" if error else ""
