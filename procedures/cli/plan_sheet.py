"""`ronna-plan sheet`: the case sheet of a plan, before the case."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from procedures.cli.planning_inputs import PlanArgument, PlannedSeriesOption, read_localized_ct
from procedures.cli.runs.run_argument import PageOption, telling_replacement
from ronna_hw.command_line import terminal
from ronna_hw.roles import roles_of
from ronna_hw.text import escape_controls

if TYPE_CHECKING:
    from procedures.imaging import Localization, Volume
    from procedures.planning.plan_model import Plan
    from procedures.reporting.case_sheet.sheet import CaseSheet, SheetTheatre


def sheet(
    plan_file: PlanArgument,
    series_dir: PlannedSeriesOption,
    config: Annotated[
        Path | None,
        Option(
            "--config",
            metavar="THEATRE",
            help="Theatre file, for its limits, its records and the depth stops [default: none].",
        ),
    ] = None,
    dual: Annotated[bool, Option("--dual", help="Of a case with two arms.")] = False,
    out: PageOption = Path("sheet.html"),
    as_json: terminal.JsonOption = False,
) -> None:
    """Write the case sheet of a plan, two pages to print: plan, spheres, limits, and who answers what.

    The plan is checked against its CT as ronna-plan check does without an arm. The sheet names no patient.
    Exit codes: 0 written, 1 the plan or the series is unusable, 2 usage, 130 interrupted.
    """
    from procedures.planning.plan_check import require_spheres
    from procedures.planning.plan_file import read_plan
    from ronna_hw.config import read_theatre_file

    theatre = None if config is None else read_theatre_file(config)
    plan = read_plan(plan_file)
    require_spheres(plan)
    volume, found, uncounted = read_localized_ct(
        series_dir, needs_markers=False, are_implanted=plan.implanted > 0
    )
    from procedures.reporting.case_sheet.sheet import SheetTheatre

    stated = SheetTheatre() if theatre is None else SheetTheatre.of_file(theatre)
    built = _build_sheet(plan_file, plan, volume, found, stated, uncounted, dual=dual)
    with telling_replacement(out):
        page = built.write(out)
    if as_json:
        terminal.print_json({"page": str(page)})
    else:
        sys.stdout.write(f"{escape_controls(str(page))}\n")


def _build_sheet(
    plan_file: Path,
    plan: Plan,
    volume: Volume,
    found: Localization | None,
    theatre: SheetTheatre,
    remarks: tuple[str, ...],
    *,
    dual: bool,
) -> CaseSheet:
    """Check the plan and build its sheet. Raises PLAN errors."""
    import numpy as np

    from procedures.imaging.trajectory_cuts import trajectory_cuts
    from procedures.planning.head_in_ct import fit_head
    from procedures.planning.plan_check import check_plan
    from procedures.reporting.case_sheet.sheet import MOST_PICTURES, sheet_of_plan
    from procedures.reporting.files import Picture, data_url
    from procedures.steps.clinical.fiducial_localization import DoubtfulSphere

    centres_mm = None if found is None else [marker.centre_mm for marker in found.markers]
    check = check_plan(plan, volume, fiducials_mm=centres_mm, bore=theatre.bore, plan_name=str(plan_file))
    check.require()
    head = fit_head(volume)
    lines = {one.id: (np.array(one.entry_mm), np.array(one.target_mm)) for one in plan.trajectories}
    return sheet_of_plan(
        f"Case sheet of {plan_file.name}",  # folders are often named after the patient
        plan,
        head,
        () if found is None else found.markers,
        [] if found is None else [DoubtfulSphere.of(one) for one in found.doubtful],
        theatre=theatre,
        remarks=(*volume.warnings, *check.warnings, *remarks),
        pictures=[
            Picture(name, data_url(trajectory_cuts(volume, lines, name, np.array(head.centre_mm))))
            for name in list(lines)[:MOST_PICTURES]
        ],
        roles=roles_of(dual=dual),
    )
