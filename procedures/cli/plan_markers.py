"""`ronna-plan markers`: from a plan and a head to a file, a picture and a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.planning_inputs import read_volume, require_one_head
from procedures.planning.errors import WrongSeries
from procedures.planning.head_in_ct import head_shape
from procedures.planning.marker_sites import head_of_scene, propose_markers
from procedures.planning.plan_file import read_plan
from procedures.reporting.pictures import marker_picture
from ronna_hw.command_line import terminal
from ronna_hw.command_line.options import require_new
from ronna_hw.marker_template import TemplateMarker
from ronna_hw.records import write_whole

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume


def propose(
    plan_file: Path,
    out: Path,
    series_dir: Path | None,
    scene: Path | None,
    markers: int,
    error_mm: float,
    seed: int,
    *,
    as_json: bool,
) -> None:
    """Raises PLAN-001 to PLAN-003, PLAN-014, PLAN-016, PLAN-021 and what reading a series raises."""
    picture = out.with_suffix(".png")
    require_one_head(series_dir, scene)
    require_new(out, picture)
    plan = read_plan(plan_file)
    trajectories = [one.trajectory for one in plan.trajectories]
    volume: Volume | None = None
    if scene is not None:
        head = head_of_scene(scene, plan)
    else:
        assert series_dir is not None
        volume = read_volume(series_dir)
        if plan.series_instance_uid != volume.series_instance_uid:
            raise WrongSeries(
                "the plan belongs to another CT series",
                expected=plan.series_instance_uid,
                got=volume.series_instance_uid,
            )
        head = head_shape(volume)
    found = propose_markers(head, trajectories, markers, error_mm, volume=volume, seed=seed)
    import tomli_w

    write_whole(out, tomli_w.dumps(found.model_dump(mode="json", by_alias=True)).encode())
    write_whole(picture, marker_picture(found, head, trajectories))
    if as_json:
        terminal.print_json({**found.model_dump(mode="json", by_alias=True), "picture": str(picture)})
        return
    print_markers(f"{out}: {len(found.markers)} markers", found.markers)
    terminal.print_table(
        f"expected from marker errors of {found.marker_error_mm:g} mm each",
        ["target", "rms mm", "random mm"],
        [[one.target, f"{one.expected_mm:.3f}", f"{one.usual_mm:.3f}"] for one in found.targets],
    )


def print_markers(title: str, markers: Sequence[TemplateMarker]) -> None:
    """Where each marker goes, and the direction of its post."""
    terminal.print_table(
        title,
        ["marker", "centre LPS mm", "post"],
        [
            [
                str(number),
                " ".join(f"{value:.1f}" for value in one.centre_mm),
                " ".join(f"{value:.3f}" for value in one.post),
            ]
            for number, one in enumerate(markers, start=1)
        ],
    )
