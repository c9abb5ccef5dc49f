"""`ronna-sim scene`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim.world.options import Carrier


def scene(
    scene: Annotated[str, typer.Option(help="default, mini, bench, or a scene file.")] = "default",
    seed: Annotated[int, typer.Option(min=0, help="Seed of a named scene.")] = 0,
    markers: Annotated[int | None, typer.Option(min=3, max=8, help="Spheres on the head.")] = None,
    targets: Annotated[int | None, typer.Option(min=1, max=10, help="Trajectories of the plan.")] = None,
    fiducials: Annotated[
        Carrier, typer.Option(help="Fixation of the spheres: screws, or the x-shaped frame.")
    ] = Carrier.FREE,
    template: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Implant the spheres with this template from `ronna-plan template`."
        ),
    ] = None,
) -> None:
    """Print the full ground truth of a scene as TOML, as a starting point for your own scene."""
    import tomli_w

    from ronna_hw.marker_template import read_marker_template
    from sim.errors import BadScene
    from sim.world.process import load_scene
    from sim.world.scene.named_scenes import SCENES, named_scene

    if template is None:
        truth = load_scene(scene, seed=seed, markers=markers, targets=targets, fiducials=fiducials)
    else:
        if scene not in SCENES or markers is not None or fiducials is not Carrier.FREE:
            raise BadScene("a template belongs to a named scene and fixes the number of markers")
        implanted = read_marker_template(template)
        truth = named_scene(scene, seed=seed, targets=targets, template=implanted)
    typer.echo(tomli_w.dumps(truth.model_dump(mode="json", by_alias=True, exclude_none=True)), nl=False)
