"""`ronna-sim scene`."""

from __future__ import annotations

from typing import Annotated

import typer


def scene(
    scene: Annotated[str, typer.Option(help="default, mini, bench, or a scene file.")] = "default",
    seed: Annotated[int, typer.Option(min=0, help="Seed of a named scene.")] = 0,
    markers: Annotated[int | None, typer.Option(min=3, max=8, help="Spheres on the head.")] = None,
    targets: Annotated[int | None, typer.Option(min=1, max=10, help="Trajectories of the plan.")] = None,
) -> None:
    """Print the whole truth of a scene as TOML: a starting point for a scene of your own."""
    import tomli_w

    from sim.theatre.process import load_scene

    truth = load_scene(scene, seed=seed, markers=markers, targets=targets)
    typer.echo(tomli_w.dumps(truth.model_dump(mode="json", by_alias=True, exclude_none=True)), nl=False)
