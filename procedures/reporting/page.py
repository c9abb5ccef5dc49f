"""Content of the report, section by section, as its templates print it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from procedures.engine.run_folder import targets_in_doubt
from procedures.imaging.trajectory_cuts import PLAN_PICTURE
from procedures.reporting.ending import advise, ending_of, is_resumable
from procedures.reporting.files import Picture, PostoperativeResult, load_pictures
from procedures.reporting.outcome import RunError, Truth
from procedures.reporting.run_events import moves
from procedures.reporting.run_reading import RunReading, UsedRegistration
from procedures.reporting.sections.calibration import Calibration, read_calibration
from procedures.reporting.sections.course import Course, read_course
from procedures.reporting.sections.devices import Devices, read_devices
from procedures.reporting.sections.evidence import EvidenceSection, read_evidence
from procedures.reporting.sections.header import Header, RunOpening, read_header
from procedures.reporting.sections.plan import PlanSection, read_plan
from procedures.reporting.sections.spheres import Spheres, read_spheres
from procedures.reporting.sections.stability import Stability, read_stability
from procedures.reporting.sections.targets import Targets, read_targets
from procedures.reporting.sections.verdict import VerdictSection, describe_exclusions, read_assistant_work
from procedures.reporting.tables import TargetTable, target_rows
from ronna_hw.evidence.unsealed import describe_unsealed_files
from ronna_hw.host.port_users import find_folder_holder


@dataclass(frozen=True)
class Page:
    """Sections of a report, in the order of the page. What a run has not come to is None or empty."""

    header: Header
    verdict: VerdictSection
    calibration: Calibration
    after: PostoperativeResult | None
    plan_pictures: tuple[Picture, ...]
    targets: Targets | None
    stability: Stability | None
    plan: PlanSection | None
    registrations: tuple[UsedRegistration, ...]
    spheres: Spheres
    course: Course
    devices: Devices
    evidence: EvidenceSection


def read_page(
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
            advice=advise(ending, resumable=is_resumable(reading)),
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
        stability=read_stability(reading),
        plan=plan,
        registrations=reading.registrations,
        spheres=read_spheres(reading, truth),
        course=read_course(reading, opening.processor),
        devices=read_devices(reading),
        evidence=read_evidence(reading),
    )
