"""`ronna-plan new`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ronna_hw.command_line import terminal
from ronna_hw.command_line.new_files import require_new

READING_SHARE = 0.4  # of the progress bar; the rest is for localizing the spheres


def new(
    series_dir: Annotated[Path, typer.Argument(metavar="SERIES_DIR", help="Folder of the CT series.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The plan file to write.")] = Path(
        "plan.toml"
    ),
) -> None:
    """Create a plan for a CT: series, patient position and spheres are filled in; you add the trajectories.

    Exit codes: 0 written, 1 the series is unusable, 2 usage, 3 no spheres, 130 interrupted.
    """
    from procedures.imaging import localize, read_series
    from procedures.planning.plan.new import new_plan
    from ronna_hw.records import write_whole

    require_new(out)
    with terminal.progress_bar("reading the series") as advance:
        volume = read_series(series_dir, progress=lambda share: advance(share * READING_SHARE))
        found = localize(
            volume, progress=lambda share: advance(READING_SHARE + (1.0 - READING_SHARE) * share)
        )
    centres_mm = [marker.centre_mm.tolist() for marker in found.markers]
    text = new_plan(volume.series_instance_uid, volume.patient_position, centres_mm, series_dir.name)
    write_whole(out, text.encode(), exclusive=True)
    terminal.say(f"{out}: {len(centres_mm)} spheres; add the trajectories")
    terminal.say(f"then: ronna-plan check {out} --ct {series_dir}")
