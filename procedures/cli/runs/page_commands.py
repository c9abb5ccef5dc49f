"""`ronna-procedure compare` and `sheet`: pages about runs, to be read and printed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from typer import Argument

from procedures.cli.runs.run_argument import PageOption, RunArgument, require_run_folder, telling_replacement
from ronna_hw.command_line.terminal import JsonOption, print_json
from ronna_hw.text import escape_controls

SecondRun = Annotated[
    Path, Argument(metavar="OTHER", help="Folder of the run beside it.", callback=require_run_folder)
]


def compare_command(
    run_folder: RunArgument,
    other: SecondRun,
    out: PageOption = Path("comparison.html"),
    as_json: JsonOption = False,
) -> None:
    """Compare two runs on a page: options, versions, steps and times, registration, targets and findings.

    Both folders are only read. With --json also what differs and the errors at the targets.
    """
    from procedures.reporting.comparison.page import compare_runs
    from procedures.runs.folders import require_two_runs

    require_two_runs(run_folder, other)
    compared = compare_runs(run_folder, other)
    with telling_replacement(out):
        path = compared.write(out)
    if as_json:
        print_json({"page": str(path), **compared.as_payload()})
    else:
        sys.stdout.write(f"{escape_controls(str(path))}\n")


def sheet_command(
    run_folder: RunArgument, out: PageOption = Path("sheet.html"), as_json: JsonOption = False
) -> None:
    """Write the case sheet of a run, two pages to print: plan, spheres, limits, and who answers what.

    Before a case, ronna-plan sheet writes it from plan and CT.
    """
    from procedures.exchange.errors import NOTHING_TO_EXPORT
    from procedures.reporting.case_sheet.sheet import sheet_of_run

    sheet = sheet_of_run(run_folder)
    if sheet is None:
        raise NOTHING_TO_EXPORT(
            f"{run_folder.name} has no checked plan",
            expected="a case that got past plan_check",
            action="ronna-plan sheet PLAN --ct SERIES_DIR writes the sheet from plan and CT.",
        )
    with telling_replacement(out):
        path = sheet.write(out)
    if as_json:
        print_json({"page": str(path)})
    else:
        sys.stdout.write(f"{escape_controls(str(path))}\n")
