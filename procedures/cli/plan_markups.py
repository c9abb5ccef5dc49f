"""`ronna-plan from-markups` and `to-markups`: trajectories drawn in 3D Slicer, and back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from procedures.cli import planning_inputs
from procedures.exchange.line_order import LineOrder
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import PATH_PROBLEM, UsageMistake
from ronna_hw.command_line.options import require_new
from ronna_hw.text import format_count

if TYPE_CHECKING:
    from procedures.exchange.markup_lines import MarkupLine
    from procedures.fusion.record import Fusion
    from procedures.planning.head_in_ct import HeadEllipsoid
    from procedures.planning.plan_check import PlanCheck

USUAL_MARGIN_MM, USUAL_STANDOFF_MM = 2.0, 30.0
MARKUPS_ENDING = ".mrk.json"
IN_CT, IN_OTHER = "ct", "other"
FRAME_NOT_STATED = (
    "3D Slicer's files do not say on which series a line was drawn: one drawn on another scan of the head "
    "may fit the CT as well; look at each trajectory in the planner"
)


def from_markups(
    files: Annotated[list[Path], Argument(metavar="FILE...", help="Line markups of 3D Slicer, .mrk.json.")],
    series_dir: planning_inputs.PlannedSeriesOption,
    instrument_length_mm: Annotated[
        float, Option("--instrument-length-mm", help="From its tip to where a depth stop still holds.")
    ],
    out: Annotated[Path, Option("--out", metavar="FILE", help="The plan file to write.")] = Path("plan.toml"),
    order: Annotated[
        LineOrder | None,
        Option("--order", help="Order of the points of lines whose labels do not say entry and target."),
    ] = None,
    fiducials: Annotated[
        str, Option("--fiducials", metavar="free|xframe", help="Single spheres, or the x-shaped frame.")
    ] = "free",
    margin_mm: Annotated[
        float, Option("--margin-mm", help="Largest accepted target error.")
    ] = USUAL_MARGIN_MM,
    standoff_mm: Annotated[
        float, Option("--standoff-mm", help="From the entry to the lower end of the guide.")
    ] = USUAL_STANDOFF_MM,
    fusion_file: Annotated[
        Path | None,
        Option("--fusion", metavar="FILE", help="The targets were chosen in a series fused by this file."),
    ] = None,
    points_in: Annotated[
        str | None,
        Option(
            "--points-in",
            metavar=f"{IN_CT}|{IN_OTHER}",
            help="With --fusion: the points are in the frame of the CT, because the other series was shown "
            "through the fusion, or in that of the other series.",
        ),
    ] = None,
) -> None:
    """Create a plan from lines that were drawn in 3D Slicer, one trajectory for each.

    Positions in RAS are converted by what the file states. The plan is checked against the CT, with its
    spheres, and written only if it fits. Exit codes: 0 written, 1 markups, series or plan are unusable, 2
    usage, 3 no spheres, 130 interrupted.
    """
    from procedures.exchange.markup_lines import read_lines
    from procedures.fusion.record import read_fusion
    from procedures.imaging.dicom.slice_headers import read_headers
    from procedures.planning.head_in_ct import fit_head
    from procedures.planning.plan_check import check_plan
    from procedures.planning.plan_file import parse_plan, write_plan

    require_new(out)
    if (fusion_file is None) != (points_in is None) or points_in not in (None, IN_CT, IN_OTHER):
        raise UsageMistake(
            "--fusion and --points-in belong together",
            expected=f"--points-in {IN_CT} or {IN_OTHER} with --fusion, or neither",
            got=f"--points-in {points_in}",
            action="Say in whose frame the points are; it cannot be seen from the file.",
        )
    header = read_headers(series_dir)[0]
    fused = None if fusion_file is None else read_fusion(fusion_file, header.series_instance_uid)
    frame = header.frame_of_reference_uid
    if fused is not None and points_in == IN_OTHER:
        frame = fused[0].other_frame_uid
    lines = [line for file in files for line in read_lines(file, frame, order)]
    volume, centres_mm, _ = planning_inputs.read_ct(series_dir, needs_markers=True)
    content: dict[str, Any] = {
        "schema": 1,
        "series_instance_uid": volume.series_instance_uid,
        "patient_orientation": volume.patient_position,
        "implanted": len(centres_mm or ()),
        "fiducials": fiducials,
        "tool": "guide",
        "standoff_mm": standoff_mm,
        "instrument_length_mm": instrument_length_mm,
        "trajectories": [
            _describe(line, margin_mm, None if fused is None else fused[0], points_in) for line in lines
        ],
    }
    if fused is not None:
        fusion, digest = fused
        uid, modality = fusion.other_series_uid, fusion.modality
        content["fusion"] = {"series_instance_uid": uid, "modality": modality, "record_sha256": digest}
    names = ", ".join(file.name for file in files)
    plan = parse_plan(content, names)
    result = check_plan(plan, volume, fiducials_mm=centres_mm, plan_name=str(out), ct_name=str(series_dir))
    for sentence in (*volume.warnings, *result.warnings):
        terminal.tell(f"warning: {sentence}")
    result.require()
    if not all(line.is_frame_stated for line in lines):
        terminal.tell(FRAME_NOT_STATED)
    write_plan(out, plan, (f"Trajectories from {names}; spheres counted in the CT: count the screws, too.",))
    _tell_sides(result, fit_head(volume), out, series_dir)


def to_markups(
    plan_file: planning_inputs.PlanArgument,
    series_dir: planning_inputs.PlannedSeriesOption,
    out: Annotated[Path, Option("--out", metavar="FILE", help="The .mrk.json to write.")],
) -> None:
    """Write the trajectories of a plan as line markups for 3D Slicer, in LPS of the CT.

    The labels say which end is the target, so that from-markups reads them back. Exit codes: 0 written, 1
    plan or series are unusable, 2 usage, 130 interrupted.
    """
    from procedures.exchange.allowed_fields import PLANNED
    from procedures.exchange.export_tables import CtIdentity
    from procedures.exchange.trajectory_lines import format_lines, planned_line
    from procedures.imaging.dicom.slice_headers import read_headers
    from procedures.planning.errors import WRONG_SERIES
    from procedures.planning.plan_file import read_plan
    from ronna_hw.records import write_atomically

    if not out.name.endswith(MARKUPS_ENDING):
        raise PATH_PROBLEM(
            f"--out: {out} is no markups file",
            expected=f"a file that ends in {MARKUPS_ENDING}",
            action="Name another.",
        )
    require_new(out)
    plan, header = read_plan(plan_file), read_headers(series_dir)[0]
    if plan.series_instance_uid != header.series_instance_uid:
        raise WRONG_SERIES(
            "the plan belongs to another CT series",
            expected=plan.series_instance_uid,
            got=header.series_instance_uid,
        )
    ct = CtIdentity(header.series_instance_uid, header.frame_of_reference_uid, header.study_instance_uid)
    lines = [planned_line(one.id, one) for one in plan.trajectories]
    write_atomically(out, format_lines(lines, ct, PLANNED).encode(), exclusive=True)
    terminal.say(f"{out}: {format_count(len(lines), 'line')}; in 3D Slicer load the CT, then this file")


def _describe(
    line: MarkupLine, margin_mm: float, fusion: Fusion | None, points_in: str | None
) -> dict[str, Any]:
    """Return the table of a trajectory in a plan, in the CT's frame."""
    entry_mm, target_mm = list(line.entry_mm), list(line.target_mm)
    chosen: dict[str, float] = {}
    if fusion is not None:
        if points_in == IN_OTHER:
            entry_mm, target_mm = fusion.map_to_ct([entry_mm, target_mm]).tolist()
        chosen = {"fusion_error_mm": round(fusion.expect_error_mm(target_mm), 3)}
    return {"id": line.name, "entry_mm": entry_mm, "target_mm": target_mm, "margin_mm": margin_mm, **chosen}


def _tell_sides(result: PlanCheck, head: HeadEllipsoid, out: Path, series_dir: Path) -> None:
    """Say what was written, and on which side each trajectory enters: only that tells left from right."""
    for one in result.plan.trajectories:
        fused = "" if one.fusion_error_mm is None else f", fusion {one.fusion_error_mm:.2f} mm"
        side = head.side_of(one.entry_mm, one.target_mm)
        terminal.say(f"{one.id}: {side}, {one.depth_mm:.1f} mm deep{fused}")
    if result.only_side_tells:
        terminal.tell(planning_inputs.ONLY_THE_SIDE_TELLS)
    terminal.say(
        f"{out}: {format_count(len(result.plan.trajectories), 'trajectory', 'trajectories')}, "
        f"{format_count(result.plan.implanted, 'sphere')}"
    )
    terminal.say(f"then: ronna-plan open {series_dir} --plan {out}")
