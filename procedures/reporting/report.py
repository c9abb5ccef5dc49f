"""The report `report.html`: a self-contained record of what a run did, how it ended, and how accurately.

Everything in it comes from the run's folder, however incomplete; only the truth of a simulated theatre comes
from its verifier and is passed in.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from procedures.engine.run_folder import targets_in_doubt
from procedures.imaging.trajectory_cuts import PLAN_PICTURE
from procedures.reporting.ending import advise, ending_of, is_resumable
from procedures.reporting.files import (
    REPORT_FOLDER,
    Picture,
    PostoperativeResult,
    ReportFiles,
    clearance_columns,
    load_check,
    load_pictures,
    parts_columns,
    pose_columns,
    store_check,
    target_columns,
)
from procedures.reporting.kept_truth import store_truth
from procedures.reporting.outcome import RunError, Truth
from procedures.reporting.page_templates import load_template
from procedures.reporting.run_events import moves
from procedures.reporting.run_reading import RunReading, UsedRegistration, read_for_report
from procedures.reporting.sections.calibration import Calibration, read_calibration
from procedures.reporting.sections.course import Course, read_course
from procedures.reporting.sections.devices import Devices, read_devices
from procedures.reporting.sections.evidence import EvidenceSection, read_evidence
from procedures.reporting.sections.header import Header, RunOpening, read_header
from procedures.reporting.sections.plan import PlanSection, read_plan
from procedures.reporting.sections.spheres import Spheres, read_spheres
from procedures.reporting.sections.stability import Stability, read_stability
from procedures.reporting.sections.surface import SURFACE_PICTURES, SurfaceSection, read_surface
from procedures.reporting.sections.targets import Targets, read_targets
from procedures.reporting.sections.two_arms import TwoArms, read_two_arms
from procedures.reporting.sections.verdict import VerdictSection, describe_exclusions, read_assistant_work
from procedures.reporting.tables import TargetTable, target_rows
from ronna_hw.evidence.manifest import REPORT_FILE
from ronna_hw.evidence.unsealed import describe_unsealed_files
from ronna_hw.host.port_users import find_folder_holder
from ronna_hw.records import write_atomically
from ronna_hw.text import escape_controls

TEMPLATE = "page.html.j2"


@dataclass(frozen=True)
class Page:
    """Sections of a report, in the order of the page. What a run has not come to is None or empty."""

    header: Header
    verdict: VerdictSection
    calibration: Calibration
    after: PostoperativeResult | None
    plan_pictures: tuple[Picture, ...]
    targets: Targets | None
    two_arms: TwoArms | None
    stability: Stability | None
    plan: PlanSection | None
    registrations: tuple[UsedRegistration, ...]
    surface: SurfaceSection | None
    surface_pictures: tuple[Picture, ...]
    spheres: Spheres
    course: Course
    devices: Devices
    evidence: EvidenceSection


def write_report(
    run: Path,
    *,
    truth: Truth | None = None,
    error: RunError | None = None,
    out: Path | None = None,
    after: PostoperativeResult | None = None,
    unconfirmed: Sequence[str] = (),
    seals: bool = False,
) -> Path:
    """Write the report of a run to its folder or to `out`, and return the path.

    `truth` is the theatre verifier's result, by default the sealed one; `after` the postoperative check, by
    default the stored one. With `seals` the caller seals run, truth and report next, and the report tells the
    ending that everybody reads then. `error` is the command line's. `unconfirmed` says what no seal vouches
    for; what had none when the run was resumed is in its journal. Raises OSError when it cannot be written,
    and nothing that the run's content can cause.
    """
    out = run if out is None else out
    reading = read_for_report(run)
    files = ReportFiles(out)
    truth = reading.truth if truth is None else truth
    if seals:
        reading = reading.sealed_with(truth)
    if truth is not None:
        store_truth(out, truth)
    after = load_check(reading) if after is None else after
    if after is not None and out != run:
        store_check(out / REPORT_FOLDER, after)
    page = _read_page(reading, truth, error, after, unconfirmed)
    _write_drawings(files, page)
    path = out / REPORT_FILE
    # The templates collect the titles of what is not on paper in `unprinted`.
    html = load_template(TEMPLATE).render(page=page, files=files.written, unprinted=[])
    write_atomically(path, html.encode())
    return path


def _read_page(
    reading: RunReading,
    truth: Truth | None,
    error: RunError | None,
    after: PostoperativeResult | None,
    unconfirmed: Sequence[str],
) -> Page:
    """Read every section of the page. Arguments as for `write_report`."""
    run, journal = reading.folder, reading.run.journal
    opening = RunOpening.of(reading.run.opened)
    table = TargetTable(target_rows(reading, truth or Truth()))
    holder = find_folder_holder(run)
    ending = ending_of(reading, error, is_writer=holder is not None and holder.pid == os.getpid())
    plan = read_plan(reading)
    return Page(
        header=read_header(run.name, reading, opening, table, () if plan is None else plan.rows),
        verdict=VerdictSection(
            ending=ending,
            advice=advise(
                ending, resumable=is_resumable(reading), run=escape_controls(shlex.quote(run.name))
            ),
            table=table,
            in_doubt=targets_in_doubt(journal),
            assistant=read_assistant_work(reading),
            left_out=describe_exclusions(reading),
            moves=moves(journal),
            unconfirmed=(*describe_unsealed_files(tuple(journal)), *unconfirmed),
            problems=reading.problems,  # also those that the sections below note
        ),
        calibration=read_calibration(run),
        after=after,
        plan_pictures=load_pictures(reading, PLAN_PICTURE),
        targets=read_targets(reading, table, simulated=bool(opening.banner)),
        two_arms=read_two_arms(reading),
        stability=read_stability(reading),
        plan=plan,
        registrations=reading.registrations,
        surface=read_surface(reading),
        surface_pictures=load_pictures(reading, SURFACE_PICTURES),
        spheres=read_spheres(reading, truth),
        course=read_course(reading, opening.processor),
        devices=read_devices(reading),
        evidence=read_evidence(reading),
    )


def _write_drawings(files: ReportFiles, page: Page) -> None:
    """Write each drawing and its data to files."""
    if page.plan is not None:
        for one in page.plan.clearances:
            files.drawing(f"clearance-{one.stem}", one.picture, clearance_columns(one.motions))
    if page.targets is not None:
        table = page.targets.table
        files.drawing("targets", page.targets.picture, target_columns(table.rows))
        if page.targets.parts_picture:
            files.drawing("error_parts", page.targets.parts_picture, parts_columns(table.split))
        if page.targets.poses:
            files.table("guide_poses", pose_columns(page.targets.poses))
    if page.course.spans:
        files.drawing("timeline", page.course.timeline_picture, list(map(asdict, page.course.spans)))
    if page.devices.link_bins:
        bins = [one._asdict() for one in page.devices.link_bins]
        files.drawing("robot_link", page.devices.link_picture, bins)
    if page.calibration.looks:
        looks = [{"look": number} | one._asdict() for number, one in enumerate(page.calibration.looks, 1)]
        files.drawing("looks", page.calibration.looks_picture, looks)
