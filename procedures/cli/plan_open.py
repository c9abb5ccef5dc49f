"""`ronna-plan open` and `ronna-plan new`."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from procedures.cli.planning_inputs import (
    DEFAULT_STRATEGY,
    HeadOption,
    HomeOption,
    StrategyOption,
    read_ct,
    require_theatre_options,
)
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import PathProblem
from ronna_hw.command_line.options import VERBOSE_FLAG, require_new

MODULE = "console.planning.serving"


def open_plan(
    series_dir: Annotated[Path, typer.Argument(metavar="CT_DIR", help="Folder of the CT series.")],
    plan_file: Annotated[
        Path | None,
        typer.Option(
            "--plan", metavar="FILE", help="The plan, new or existing [default: plan.toml next to CT_DIR]."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Theatre file: its arm is checked while you plan."),
    ] = None,
    strategy: StrategyOption = DEFAULT_STRATEGY,
    robot_from_ct: HeadOption = None,
    home: HomeOption = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any free one.")] = 0,
) -> None:
    """Plan in the browser: slices, markers, trajectories, checked while they are drawn. Runs until Ctrl-C.

    The page's address, which includes a key, is printed on standard error.
    """
    from procedures.runs.console_link import check_console

    require_theatre_options(config, robot_from_ct, home, strategy)
    check_console()
    if not series_dir.is_dir():
        raise PathProblem(f"{series_dir} does not exist", expected="the folder of a CT series")
    request = {
        "series": str(series_dir.resolve()),
        "plan": str((plan_file or series_dir.resolve().parent / "plan.toml").resolve()),
        "port": port,
        "config": config and str(config.resolve()),
        "strategy": strategy,
        "robot_from_ct": robot_from_ct,
        "home_deg": home,
    }
    more = [VERBOSE_FLAG] if VERBOSE_FLAG in sys.argv else []
    os.execv(sys.executable, [sys.executable, "-P", "-m", MODULE, json.dumps(request), *more])


CT_FOLDER, PLAN_FILE = "ct", "plan.toml"  # side by side in the folder of a case


def new(
    series_dir: Annotated[Path, typer.Argument(metavar="SERIES_DIR", help="Folder of the CT series.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The plan file to write.")] = Path(
        "plan.toml"
    ),
) -> None:
    """Create a plan for a CT: series, patient position and spheres are filled in; you add the trajectories.

    Exit codes: 0 written, 1 the series is unusable, 2 usage, 3 no spheres, 130 interrupted.
    """
    from procedures.planning.plan_file import new_plan
    from ronna_hw.records import write_whole

    require_new(out)
    volume, centres_mm, _ = read_ct(series_dir, needs_markers=True)
    assert centres_mm is not None, "it has raised"
    text = new_plan(volume.series_instance_uid, volume.patient_position, centres_mm, series_dir.name)
    write_whole(out, text.encode(), exclusive=True)
    terminal.say(f"{out}: {len(centres_mm)} spheres; add the trajectories")
    case = series_dir.resolve().parent
    if series_dir.resolve().name == CT_FOLDER and out.resolve() != case / PLAN_FILE:
        terminal.say(
            f"it was written to {out.resolve()}; ronna-procedure run --case {case} expects it beside the "
            f"series, as {case / PLAN_FILE}"
        )
    terminal.say(f"then: ronna-plan check {out} --ct {series_dir}")
