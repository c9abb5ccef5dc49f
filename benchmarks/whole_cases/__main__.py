"""Whole simulated cases of every strategy on a block of seeds, as decision 31 has it.

    python -m benchmarks.whole_cases FOLDER --block COMMIT                    # everything, in its order
    python -m benchmarks.whole_cases FOLDER --block COMMIT --only uncalibrated
    python -m benchmarks.whole_cases FOLDER                                   # the table of what is there

Each case is `ronna-procedure run --sim`, as a user types it. `cases.jsonl` in the folder keeps every attempt;
the same command continues. `summary.json` has the figures of the table.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.whole_cases.block import draw_block
from benchmarks.whole_cases.cases import load_attempts, measure_cases
from benchmarks.whole_cases.conditions import list_conditions
from benchmarks.whole_cases.table import summarize, tabulate

SUMMARY_FILE = "summary.json"


def main(
    folder: Annotated[Path, typer.Argument(help="New folder, or one to continue.")],
    block: Annotated[str, typer.Option(help="Commit that draws the seeds, 40 digits.")] = "",
    only: Annotated[list[str], typer.Option(help="Group, or group and strategy; repeatable.")] = [],  # noqa: B006
    seeds: Annotated[list[int], typer.Option(help="These instead of a block, to try it.")] = [],  # noqa: B006
) -> None:
    """Run whole cases with every strategy, and print their errors as a table."""
    chosen = [one for one in list_conditions() if not only or {one.group, one.name} & set(only)]
    drawn = draw_block(block) if block else tuple(seeds)
    for attempt in measure_cases(folder, chosen, drawn):
        typer.echo(json.dumps(attempt), err=True)
    summary = summarize(load_attempts(folder))
    (folder / SUMMARY_FILE).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    for line in tabulate(summary):
        typer.echo(line)


if __name__ == "__main__":
    typer.run(main)
