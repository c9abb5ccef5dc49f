"""The case sheet: plan, spheres, limits, and who answers what, on two pages of paper.

Made from a plan with its CT before a case, or from the folder of a run. It names no patient: whose sheet it
is, and who answers, is written on it by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from procedures.imaging.markers import Marker
from procedures.imaging.trajectory_cuts import PLAN_PICTURE
from procedures.planning.guide import depth_stop_mm
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_file import describe_seal
from procedures.planning.plan_model import FiducialKind, Plan, PlannedTrajectory
from procedures.planning.short_numbers import short_plan_number, short_series_number
from procedures.reporting.case_sheet.answering import (
    QuestionRow,
    describe_answering,
    questions_of_branches,
    questions_of_course,
)
from procedures.reporting.case_sheet.limits import LimitRow, limits_of_case
from procedures.reporting.files import Picture, load_pictures
from procedures.reporting.page_file import write_page
from procedures.reporting.page_templates import load_template
from procedures.reporting.run_options import RunOptions, read_options
from procedures.reporting.run_reading import read_for_report
from procedures.reporting.sections.course import read_course
from procedures.steps.clinical.fiducial_localization import DoubtfulSphere, LocalizedFiducials
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.surface.landmark_reading import TOUCHED
from ronna_hw.calibration import DatedRecord
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.config import ProcedureSettings, TheatreFile
from ronna_hw.roles import ASSISTANT, ONE_ARM
from ronna_hw.tool_record import GuideBore, ToolRecord

TEMPLATE = "sheet.html.j2"
ARM = "arm"  # role of the master among the devices
MOST_PICTURES = 4  # that leave room for plan and spheres on the first page
FIDUCIALS = {
    FiducialKind.FREE: "on screws",
    FiducialKind.XFRAME: "on the x-shaped frame",
    FiducialKind.SURFACE: "none, the skin is scanned",
    FiducialKind.MIXED: "on screws, and the skin is scanned",
}


@dataclass(frozen=True)
class SheetTrajectory:
    """A planned trajectory as the sheet lists it."""

    planned: PlannedTrajectory
    side: str
    stop_mm: float | None  # None where no guide is known
    limit_mm: float | None  # of the predicted error; None before a registration


@dataclass(frozen=True)
class SheetTheatre:
    """Theatre as a sheet shows it; the defaults are those of a theatre file that states nothing."""

    name: str = ""
    banner: str = ""
    cell: CollisionConfig = field(default_factory=CollisionConfig)
    settings: ProcedureSettings = field(default_factory=ProcedureSettings)
    arm: str = ""  # model of the master; empty if not known
    records: tuple[DatedRecord, ...] = ()
    tools: tuple[ToolRecord, ...] = ()
    bore: GuideBore | None = None

    @classmethod
    def of_file(cls, theatre: TheatreFile) -> SheetTheatre:
        """Take what a theatre file states."""
        guide = theatre.tools.get("guide")
        return cls(
            name=theatre.theatre,
            banner=theatre.banner,
            cell=theatre.cell,
            settings=theatre.procedure,
            records=() if theatre.calibration is None else tuple(theatre.calibration.records.values()),
            tools=tuple(theatre.tools.values()),
            bore=None if guide is None else guide.bore,
        )

    @classmethod
    def of_set_up(cls, found: CheckedSetUp) -> SheetTheatre:
        """Take what a run found when it set up."""
        guide = found.tools.get("guide")
        return cls(
            cell=found.cell,
            settings=found.settings,
            arm=found.identities[ARM].model if ARM in found.identities else "",
            records=tuple(found.calibrations.records.values()),
            tools=tuple(found.tools.values()),
            bore=None if guide is None else guide.bore,
        )


@dataclass(frozen=True)
class CaseSheet:
    """Content of a case sheet."""

    title: str
    theatre: SheetTheatre
    plan: Plan
    written: datetime
    trajectories: tuple[SheetTrajectory, ...]
    markers: tuple[Marker, ...]
    doubtful: tuple[DoubtfulSphere, ...]
    remarks: tuple[str, ...]
    pictures: tuple[Picture, ...]
    limits: tuple[LimitRow, ...]
    questions: tuple[QuestionRow, ...]
    branches: tuple[QuestionRow, ...]
    answering: str

    @property
    def seal(self) -> str:
        """Name of the person who sealed the plan."""
        return describe_seal(self.plan)

    @property
    def numbers(self) -> str:
        """Numbers of series and plan, as the first question of the case shows them, and the date."""
        series, plan = short_series_number(self.plan.series_instance_uid), short_plan_number(self.plan)
        return f"CT series {series} · plan {plan} · written {self.written:%Y-%m-%d %H:%M} UTC"

    @property
    def fiducials(self) -> str:
        """Carrier of the spheres."""
        return FIDUCIALS.get(self.plan.fiducials, self.plan.fiducials.value)

    @property
    def touched(self) -> tuple[str, ...]:
        """Places of the head that are touched with the pointer, in order; none without a scan of the skin."""
        return (*TOUCHED, "the mark of an entry") if self.plan.fiducials.has_skin else ()

    @property
    def has_predictions(self) -> bool:
        """Whether the error at any target is predicted."""
        return any(one.limit_mm is not None for one in self.trajectories)

    def write(self, out: Path) -> Path:
        """Write the page to a file and return its path. Raises ARG-001, CLI-005 in a run, OSError."""
        return write_page(out, load_template(TEMPLATE).render(sheet=self, unprinted=[]))


def sheet_of_plan(
    title: str,
    plan: Plan,
    head: HeadEllipsoid,
    markers: Sequence[Marker],
    doubtful: Sequence[DoubtfulSphere],
    *,
    theatre: SheetTheatre,
    remarks: Sequence[str] = (),
    pictures: Sequence[Picture] = (),
    limits_mm: dict[str, float] | None = None,
    roles: Sequence[str] = ONE_ARM,
    options: RunOptions | None = None,
) -> CaseSheet:
    """Build the sheet of a checked plan. `limits_mm` are those of predicted errors, by target."""
    options = RunOptions() if options is None else options
    return CaseSheet(
        title=title,
        theatre=theatre,
        plan=plan,
        written=datetime.now(UTC),
        trajectories=tuple(
            SheetTrajectory(
                planned,
                head.side_of(planned.entry_mm, planned.target_mm),
                None if theatre.bore is None else depth_stop_mm(plan, planned, theatre.bore),
                (limits_mm or {}).get(planned.id),
            )
            for planned in plan.trajectories
        ),
        markers=tuple(markers),
        doubtful=tuple(doubtful),
        remarks=tuple(remarks),
        pictures=tuple(pictures[:MOST_PICTURES]),
        limits=limits_of_case(
            theatre.cell, theatre.settings, theatre.arm, plan.fiducials, dual=ASSISTANT in roles
        ),
        questions=questions_of_course(
            roles,
            plan.fiducials,
            measure_targets=bool(options.values.get("measure_targets")),
            intraoperative=bool(options.values.get("intraoperative")),
        ),
        branches=questions_of_branches(roles, plan.fiducials),
        answering=describe_answering(options, simulated=bool(theatre.banner)),
    )


def sheet_of_run(folder: Path) -> CaseSheet | None:
    """Build the sheet of a run, or return None for one that has not come to a checked plan."""
    reading = read_for_report(folder)
    checked, spheres = reading.find(CheckedPlan), reading.find(LocalizedFiducials)
    if checked is None:
        return None
    options, opened = read_options(folder), reading.run.opened
    set_up = reading.find(CheckedSetUp)
    theatre = SheetTheatre() if set_up is None else SheetTheatre.of_set_up(set_up)
    theatre = replace(theatre, name=str(opened.get("theatre") or ""), banner=str(opened.get("banner") or ""))
    roles = options.values.get("roles")
    return sheet_of_plan(
        f"Case sheet of run {reading.run.name}",
        checked.plan,
        checked.head,
        () if spheres is None else spheres.markers,
        () if spheres is None else spheres.doubtful,
        theatre=theatre,
        remarks=(*reading.changes, *reading.problems, *read_course(reading, "").findings),
        pictures=load_pictures(reading, PLAN_PICTURE),
        limits_mm={one.target: one.limit_mm for used in reading.registrations for one in used.predictions},
        roles=tuple(map(str, roles)) if isinstance(roles, list) else ONE_ARM,
        options=options,
    )
