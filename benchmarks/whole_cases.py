"""Whole simulated cases over a range of seeds with every strategy: the figures of the README.

    python -m benchmarks.whole_cases FOLDER                   # seeds 100 to 119, calibrated and not
    python -m benchmarks.whole_cases FOLDER --seating 0.22    # spheres off their places as in parameter set S
    python -m benchmarks.whole_cases FOLDER --arm ur5e        # another arm than the KR 6

Each case is `ronna-procedure run --sim`, as a user types it. `cases.jsonl` in the folder keeps every one that
ended; the same command continues. No case is left out: a refused one counts as refused.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
import typer

from procedures.strategies.catalogue import STRATEGIES
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.host.child_process import command, run_command
from sim.world.scene.model import SEATING_ERROR_MM
from sim.world.scene.named_scenes import draw_scene

FIRST_SEED, LAST_SEED = 100, 119  # neither the scene nor any constant was chosen on these
CASE_LIMIT_S = 900.0  # on a busy machine
CASES_FILE = "cases.jsonl"
FINISHED = ("done", "in doubt", "missed")  # outcomes of a case whose steps were all done
TARGETS = 3  # of the default scene
HEADER = "| arm | strategy | cases | refused | targets | mean mm | largest mm | predicted, rms mm |"


def measure_cases(
    folder: Path, seeds: Sequence[int], seating_mm: float, arm: ArmChoice = ArmChoice.KR6
) -> None:
    """Run every case that is not in the folder yet, and append it."""
    folder.mkdir(parents=True, exist_ok=True)
    done = {_key(case) for case in load_cases(folder)}
    for calibrated, strategy, seed in product((False, True), [one.name for one in STRATEGIES], seeds):
        if (arm, calibrated, strategy, seed, seating_mm) in done:
            continue
        case = _run_case(folder, seed, arm, strategy, calibrated, seating_mm)
        with (folder / CASES_FILE).open("a", encoding="utf-8") as file:
            file.write(json.dumps(case) + "\n")
        typer.echo(json.dumps(case), err=True)


def load_cases(folder: Path) -> list[dict[str, Any]]:
    path = folder / CASES_FILE
    return (
        [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    )


def tabulate(cases: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield a Markdown table, a row for each arm, calibrated or not, and strategy."""
    yield HEADER
    yield "|" + "---|" * (HEADER.count("|") - 1)
    for arm, calibrated, strategy in dict.fromkeys(_key(one)[:3] for one in cases):
        own = [one for one in cases if _key(one)[:3] == (arm, calibrated, strategy)]
        errors_mm = np.array([error for one in own for error in one["errors_mm"]])
        predicted_mm = np.array([rms for one in own for rms in one["predicted_mm"]])
        figures = ("", "", "")
        if len(errors_mm):
            predicted = f"{predicted_mm.min():.2f}-{predicted_mm.max():.2f}"
            figures = (f"{errors_mm.mean():.3f}", f"{errors_mm.max():.3f}", predicted)
        refused = sum(one["outcome"] not in FINISHED for one in own)
        kind = "calibrated" if calibrated else "uncalibrated"
        named = kind if arm == ArmChoice.KR6 else f"{arm}, {kind}"
        reached = f"{len(errors_mm)} of {TARGETS * len(own)}"
        yield f"| {named} | `{strategy}` | {len(own)} | {refused} | {reached} | {' | '.join(figures)} |"


def _key(case: dict[str, Any]) -> tuple[str, bool, str, int, float]:
    arm = case.get("arm", ArmChoice.KR6.value)  # the only one of the first files
    return arm, case["calibrated"], case["strategy"], case["seed"], case["seating_mm"]


def _run_case(
    folder: Path, seed: int, arm: ArmChoice, strategy: str, calibrated: bool, seating_mm: float
) -> dict[str, Any]:
    runs = folder / "runs"
    scene = folder / f"scene-{arm}-{seed}.toml"
    drawn = draw_scene("default", seed=seed, arm=arm)
    changed = drawn.model_copy(
        update={"head": drawn.head.model_copy(update={"seating_error_mm": seating_mm})}
    )
    scene.write_text(tomli_w.dumps(changed.model_dump(mode="json", by_alias=True, exclude_none=True)))
    words = ["--sim", "--scene", str(scene), "--strategy", strategy, "--out", str(runs), "--json"]
    words += ["--calibrated"] * calibrated
    ended = run_command(
        "ronna-procedure run", command("procedures.cli.procedure", "run", *words), CASE_LIMIT_S
    )
    said = json.loads(ended.stdout)
    shutil.rmtree(runs, ignore_errors=True)
    reached = [one for one in said.get("targets", ()) if one.get("application_error_mm") is not None]
    return {
        "arm": arm.value,
        "calibrated": calibrated,
        "strategy": strategy,
        "seed": seed,
        "seating_mm": seating_mm,
        "outcome": said.get("outcome", "refused"),
        "error": said.get("error"),
        "errors_mm": [round(one["application_error_mm"], 4) for one in reached],
        "predicted_mm": [round(one["predicted_tre_mm"], 4) for one in reached],
    }


def main(
    folder: Annotated[Path, typer.Argument(help="New folder, or one to continue.")],
    first: Annotated[int, typer.Option(help="First seed.")] = FIRST_SEED,
    last: Annotated[int, typer.Option(help="Last seed.")] = LAST_SEED,
    seating: Annotated[
        float, typer.Option(help="Error of a refitted sphere, mm per axis.")
    ] = SEATING_ERROR_MM,
    arm: Annotated[ArmChoice, typer.Option(help="Arm of the simulated theatre.")] = ArmChoice.KR6,
) -> None:
    """Run whole cases with every strategy, and print their errors as a table."""
    measure_cases(folder, range(first, last + 1), seating, arm)
    for line in tabulate(load_cases(folder)):
        typer.echo(line)


if __name__ == "__main__":
    typer.run(main)
