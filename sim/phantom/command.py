"""`ronna-sim phantom`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from ronna_hw.command_line.console import JsonOption, print_json, progress_bar
from ronna_hw.errors import EXIT_INTERRUPTED


def phantom(
    out: Annotated[Path, typer.Option(help="Folder for ct/, plan.toml and truth.json; made if missing.")],
    scene: Annotated[str, typer.Option(help="default, mini, bench, or a scene file.")] = "default",
    seed: Annotated[int, typer.Option(min=0, help="Seed of a built-in scene.")] = 0,
    markers: Annotated[int | None, typer.Option(min=3, max=8, help="Spheres on the head.")] = None,
    targets: Annotated[int | None, typer.Option(min=1, max=10, help="Trajectories of the plan.")] = None,
    with_parent: Annotated[bool, typer.Option(hidden=True, help="End when the parent ends.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the CT series of a head phantom, a plan on it, and its truth."""
    from sim.phantom.case import write_case
    from sim.theatre.process import end_with_parent, load_scene

    if with_parent:
        end_with_parent(lambda: os._exit(EXIT_INTERRUPTED))
    truth = load_scene(scene, seed=seed, markers=markers, targets=targets)
    with progress_bar("scanning the phantom") as progress:
        case = write_case(truth, out, progress)
    if as_json:
        print_json(
            {
                "series": str(case.series),
                "plan": str(case.plan),
                "truth": str(case.truth),
                "series_instance_uid": case.series_instance_uid,
                "slices": case.slices,
                "markers": len(truth.head.fiducials),
                "targets": len(truth.head.targets),
            }
        )
        return
    typer.echo(
        f"{case.series}: {case.slices} slices, {len(truth.head.fiducials)} spheres, "
        f"{len(truth.head.targets)} trajectories in {case.plan}"
    )
