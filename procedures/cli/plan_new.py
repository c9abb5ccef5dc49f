"""`ronna-plan new`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from procedures.cli.planning_inputs import read_ct
from ronna_hw.command_line import terminal
from ronna_hw.command_line.options import require_new

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
