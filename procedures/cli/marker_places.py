"""`ronna-plan template` and `markers`: proposed positions for the markers on a head."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from procedures.planning.errors import WRONG_SERIES
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_new
from ronna_hw.records import write_atomically

if TYPE_CHECKING:
    from procedures.imaging import Volume
    from procedures.planning.fiducial_choice import Fiducials
    from procedures.planning.head_in_ct import HeadEllipsoid
    from procedures.planning.plan_model import Plan
    from ronna_hw.marker_template import TemplateMarker

SceneOption = Annotated[
    Path | None, Option("--scene", metavar="FILE", help="Output of `ronna-sim scene` instead of a CT.")
]
SpacingOption = Annotated[int, Option("--seed", min=0, help="Spacing of the positions tried.")]


def template(
    out: Annotated[Path, Option("--out", metavar="FILE", help="New file: the template, TOML.")],
    series_dir: Annotated[
        Path | None,
        Option("--ct", metavar="SERIES_DIR", help="Folder of a CT series that shows the head's skin."),
    ] = None,
    scene: SceneOption = None,
    markers: Annotated[int, Option("--markers", min=3, max=4, help="Number of markers.")] = 4,
    margin_mm: Annotated[
        float,
        Option("--margin", metavar="MM", min=1.0, max=60.0, help="Minimum difference between all distances."),
    ] = 10.0,
    seed: SpacingOption = 0,
    as_json: terminal.JsonOption = False,
) -> None:
    """Propose positions for three or four markers on a head, for a template that guides their implantation.

    All their distances differ by the margin, so that they cannot be confused; among such layouts the one with
    the smallest expected error in the middle of the head is chosen. A plan names the template as
    `template_mm`; `ronna-sim scene --template` puts the markers on a simulated head.
    """
    from procedures.planning.marker_sites import propose_template, write_template

    _require_one_head(series_dir, scene)
    require_new(out)
    head, volume = _read_head(series_dir, scene)
    proposed = propose_template(head, markers, margin_mm, volume=volume, seed=seed)
    write_template(out, proposed)
    if as_json:
        document = proposed.model_dump(mode="json", by_alias=True)
        terminal.print_json({**document, "least_difference_mm": proposed.least_difference_mm})
        return
    distances = ", ".join(f"{value:.1f}" for value in proposed.distances_mm)
    _print_markers(
        f"{out}: {markers} markers; their distances, {distances} mm, differ by at least "
        f"{proposed.least_difference_mm:.1f} mm",
        proposed.markers,
    )


def marker_places(
    plan_file: Annotated[Path, Argument(metavar="PLAN", help="Plan file with the trajectories.")],
    out: Annotated[
        Path, Option("--out", metavar="FILE", help="New TOML file; a picture is written next to it.")
    ],
    series_dir: Annotated[
        Path | None, Option("--ct", metavar="SERIES_DIR", help="CT series that shows the head's skin.")
    ] = None,
    scene: SceneOption = None,
    markers: Annotated[int, Option("--markers", min=3, max=8, help="Number of markers.")] = 5,
    error_mm: Annotated[
        float,
        Option(
            "--error", metavar="MM", min=0.001, max=5.0, help="Localization error of each marker, 3-D rms."
        ),
    ] = 0.1,
    seed: SpacingOption = 0,
    as_json: terminal.JsonOption = False,
) -> None:
    """Propose marker positions on the head that minimize the error at the planned targets.

    On free skin between forehead and vertex, clear of the trajectories. For comparison, the error with
    markers placed at random over the same skin is shown.
    """
    import tomli_w

    from procedures.planning.marker_sites import propose_markers
    from procedures.planning.plan_file import read_plan
    from procedures.reporting.pictures import marker_picture

    picture = out.with_suffix(".png")
    _require_one_head(series_dir, scene)
    require_new(out, picture)
    plan = read_plan(plan_file)
    trajectories = [one.trajectory for one in plan.trajectories]
    head, volume = _read_head(series_dir, scene, plan, plan_file)
    found = propose_markers(head, trajectories, markers, error_mm, volume=volume, seed=seed)
    document = found.model_dump(mode="json", by_alias=True)
    write_atomically(out, tomli_w.dumps(document).encode())
    write_atomically(picture, marker_picture(found, head, trajectories))
    if as_json:
        terminal.print_json({**document, "picture": str(picture)})
        return
    _print_markers(f"{out}: {len(found.markers)} markers", found.markers)
    title = f"expected from marker errors of {found.marker_error_mm:g} mm each"
    rows = [[one.target, f"{one.expected_mm:.3f}", f"{one.usual_mm:.3f}"] for one in found.targets]
    terminal.print_table(title, ["target", "rms mm", "random mm"], rows)


def choose_fiducials(
    plan_file: Annotated[Path, Argument(metavar="PLAN", help="Plan file with the trajectories.")],
    series_dir: Annotated[
        Path,
        Option(
            "--ct",
            metavar="SERIES_DIR",
            help="CT series of the head and its face, without markers or with.",
        ),
    ],
    seed: SpacingOption = 0,
    as_json: terminal.JsonOption = False,
) -> None:
    """Compare what a plan may be registered by: the skin, the skin with one to three screws, spheres alone.

    Names the fewest screws that are expected to keep the margin of every target, and the best sites for them.
    The expected error is that of the registration; the margin is compared with arm, guide and instrument
    added as usual. How far the skin moves before the scan is not known: what is usual stands for it.
    """
    import numpy as np

    from procedures.imaging.ct_surface import find_skin
    from procedures.planning.fiducial_choice import ASSUMED, compare_fiducials, name_fewest
    from procedures.planning.plan_file import read_plan
    from procedures.registration.surface.regions import HeadAxes

    plan = read_plan(plan_file)
    head, volume = _read_head(series_dir, None, plan, plan_file)
    assert volume is not None, "it is read from a series"
    skin = find_skin(volume)
    axes = HeadAxes.of(skin)
    compared = compare_fiducials(skin, head, plan, volume=volume, seed=seed)
    if as_json:
        terminal.print_json(
            {"fewest": name_fewest(compared), "compared": [one.as_payload() for one in compared]}
        )
        return
    print_expected(compared)
    for one in compared:
        if one.with_skin and one.centres_mm:
            parts = axes.name_parts(np.array(one.centres_mm))
            sites = "; ".join(
                f"{part} ({', '.join(f'{value:.0f}' for value in centre)})"
                for part, centre in zip(parts, one.centres_mm, strict=True)
            )
            terminal.say(f"{one.words} at LPS mm: {sites}")
    terminal.say(ASSUMED)
    terminal.say(name_fewest(compared))


def print_expected(compared: Sequence[Fiducials]) -> None:
    """Print the expected errors of ways to register, alone and with what comes after, against the margins."""
    from procedures.operator.margin import judge_error

    rows = [
        [
            one.words,
            at.target,
            f"{at.rms_mm:.2f}",
            f"{at.limit_mm:.2f}",
            f"{at.total_mm:.2f}",
            f"{at.total_limit_mm:.2f}",
            f"{at.margin_mm:g}",
            str(judge_error(at.margin_mm, at.total_mm, at.total_limit_mm)),
        ]
        for one in compared
        for at in one.expected
    ]
    headings = ["registered by", "target", "rms mm", "95 % mm", "with arm and guide, rms mm", "95 % mm"]
    terminal.print_table("expected error of the registration", [*headings, "margin mm", "verdict"], rows)


def _require_one_head(series_dir: Path | None, scene: Path | None) -> None:
    """Raise CLI-001 unless the head comes from exactly one source."""
    if (series_dir is None) == (scene is None):
        raise UsageMistake(
            "the head comes from --ct or from --scene",
            expected="one of them",
            got="none" if scene is None else f"--ct {series_dir} and --scene {scene}",
            action="Give --ct with the folder of a CT series, or --scene with the output of ronna-sim scene.",
        )


def _read_head(
    series_dir: Path | None, scene: Path | None, plan: Plan | None = None, plan_file: Path | None = None
) -> tuple[HeadEllipsoid, Volume | None]:
    """Read the head, which must be that of the plan, from a scene or a CT; return it with that CT.

    Raises PLAN-003, PLAN-016, PLAN-021, and errors of reading the series.
    """
    from procedures.imaging import read_series
    from procedures.planning.head_in_ct import fit_head
    from procedures.planning.scene_head import read_scene_head

    if scene is not None:
        return read_scene_head(scene, plan), None
    assert series_dir is not None
    with terminal.progress_bar("reading the series") as advance:
        volume = read_series(series_dir, progress=advance)
    if plan is not None and plan.series_instance_uid != volume.series_instance_uid:
        raise WRONG_SERIES(
            "the plan belongs to another CT series",
            expected=f"{plan.series_instance_uid} ({plan_file})",
            got=f"{volume.series_instance_uid} ({series_dir})",
        )
    return fit_head(volume), volume


def _print_markers(title: str, markers: Sequence[TemplateMarker]) -> None:
    """Print each marker's position and post direction."""
    rows = []
    for number, one in enumerate(markers, start=1):
        centre = " ".join(f"{value:.1f}" for value in one.centre_mm)
        rows.append([number, centre, " ".join(f"{value:.3f}" for value in one.post)])
    terminal.print_table(title, ["marker", "centre LPS mm", "post"], rows)
