"""Whole simulated cases of every strategy on a block of seeds, as decision 31 has it.

    python -m benchmarks.whole_cases FOLDER --block COMMIT                    # everything, in its order
    python -m benchmarks.whole_cases FOLDER --block COMMIT --only uncalibrated
    python -m benchmarks.whole_cases FOLDER                                   # the table of what is there
    python -m benchmarks.whole_cases benchmarks/results/FOLDER --page         # the same, into strategies.md

Each case is `ronna-procedure run --sim`, as a user types it. `cases.jsonl` in the folder keeps every attempt;
the same command continues. `block.json` has the seeds, `summary.json` the figures of the table.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.whole_cases.block import ROOT, count_passed_over, draw_block
from benchmarks.whole_cases.cases import load_attempts, measure_cases
from benchmarks.whole_cases.conditions import list_conditions
from benchmarks.whole_cases.page import write_page
from benchmarks.whole_cases.table import summarize, tabulate
from ronna_hw.arm.catalogue import ArmChoice

SUMMARY_FILE, BLOCK_FILE = "summary.json", "block.json"


def main(
    folder: Annotated[Path, typer.Argument(help="New folder, or one to continue.")],
    block: Annotated[str, typer.Option(help="Commit that draws the seeds, 40 digits.")] = "",
    only: Annotated[list[str], typer.Option(help="Group, or group and strategy; repeatable.")] = [],  # noqa: B006 - typer reads it once
    seeds: Annotated[list[int], typer.Option(help="These instead of a block, to try it.")] = [],  # noqa: B006 - likewise
    page: Annotated[
        bool, typer.Option("--page", help="Write the table of the page of the strategies.")
    ] = False,
) -> None:
    """Run whole cases with every strategy, and print their errors as a table."""
    chosen = [one for one in list_conditions() if not only or {one.group, one.name} & set(only)]
    drawn = draw_block(block) if block else tuple(seeds)
    if drawn:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / BLOCK_FILE).write_text(json.dumps(_describe(block, drawn)) + "\n", encoding="utf-8")
    for attempt in measure_cases(folder, chosen, drawn):
        typer.echo(json.dumps(attempt), err=True)
    summary = summarize(load_attempts(folder))
    (folder / SUMMARY_FILE).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if page:
        kept = (folder / SUMMARY_FILE).resolve().relative_to(ROOT)
        write_page(
            summary, str(kept), f"python -m benchmarks.whole_cases FOLDER --block {_commit_of(folder)}"
        )
    for line in tabulate(summary):
        typer.echo(line)


def _commit_of(folder: Path) -> str:
    return str(json.loads((folder / BLOCK_FILE).read_text(encoding="utf-8"))["commit"])


def _describe(commit: str, seeds: Sequence[int]) -> dict[str, Any]:
    """Return the block, and how many trajectories were never drawn because the arm could not take them."""
    scenes = {
        "kr6": (ArmChoice.KR6, False),
        "kr6_x_frame": (ArmChoice.KR6, True),
        "ur5e": (ArmChoice.UR5E, False),
    }
    passed_over = {
        name: sum(count_passed_over(seed, arm, x_frame=x_frame) for seed in seeds)
        for name, (arm, x_frame) in scenes.items()
    }
    return {"commit": commit, "seeds": list(seeds), "passed_over": passed_over}


if __name__ == "__main__":
    typer.run(main)
