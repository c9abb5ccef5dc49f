"""Check of the plan against the CT and its spheres, and confirmation of the patient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.imaging.dicom.slice_headers import ScanIdentity, read_scan_identity
from procedures.imaging.markers import Marker
from procedures.imaging.trajectory_cuts import PLAN_PICTURE, trajectory_cuts
from procedures.imaging.volume import Volume
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult
from procedures.operator.question import Identity, Picture, Question, ReadBack, Topic
from procedures.planning.errors import WrongMarkerCount
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_check import PlanCheck, check_plan
from procedures.planning.plan_file import describe_seal, parse_plan_bytes
from procedures.planning.plan_lock import lock_plan
from procedures.planning.plan_model import Plan, PlannedTrajectory
from procedures.planning.short_numbers import short_plan_number, short_series_number
from procedures.steps.branches import FEWEST_SPHERES, GO_ON, SPHERE_COUNT
from procedures.steps.clinical.ct_import import ImportedCt, volume_of
from procedures.steps.clinical.fiducial_localization import DoubtfulSphere, LocalizedFiducials
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.text import format_count

DATE_DIGITS = 8  # of a DICOM date, YYYYMMDD
LONGEST_SHOWN = 64  # characters, as DICOM allows for a description
OTHER_PATIENT = (
    "Nothing was moved. If it is another patient, plan or CT, begin a new run with the right ones: this run "
    "keeps its own. Repeat the step only if the answer was a slip; in a file of answers, change its line and "
    "resume with --answers FILE."
)
NOT_GIVEN = "not given"


class CheckedPlan(StepResult, kind="plan_check"):
    """The checked plan, with the head in its CT."""

    plan: Plan = Field(description="The plan file's content.")
    implanted: int = Field(description="Number of spheres to match, from the plan or as the operator agreed.")
    head: HeadEllipsoid = Field(description="The head in the CT.")
    warnings: tuple[str, ...] = Field(description="Warnings of the check.")

    def trajectory(self, identifier: str) -> PlannedTrajectory:
        """Return the planned trajectory of this name. Raises KeyError."""
        return self.plan.trajectory(identifier)


def run(context: StepContext) -> Outcome[CheckedPlan]:
    """Check the plan against the CT and its spheres. Raises one PLAN error that lists all findings."""
    localization = context.result(LocalizedFiducials)
    plan = _as_held(context)
    planned = tuple(trajectory.id for trajectory in plan.trajectories)
    if planned != context.trajectories:
        raise GateFailed(
            "the plan's trajectories have changed since the case was opened",
            expected=", ".join(context.trajectories),
            got=", ".join(planned),
            action="Start a new run with this plan.",
        )
    volume = volume_of(context)
    check = check_plan(
        plan, volume, fiducials_mm=localization.centres_mm, bore=context.workcell.tools.guide.bore
    )
    check, spheres = _accept_count(context, check, localization)
    check.require()
    head = localization.head_in(volume)
    pictures = _keep_cuts(context, volume, plan, head)
    _confirm_patient(context, check, head, pictures)
    markers = f"{format_count(spheres, 'sphere')} implanted" if spheres else "no markers"
    summary = f"{format_count(len(plan.trajectories), 'trajectory', 'trajectories')}, {markers}"
    context.note_inputs(context.clinical.plan)
    context.setting.memory.drop(Volume)  # the largest input is not needed after this
    return Outcome(
        CheckedPlan(plan=plan, implanted=spheres, head=head, warnings=tuple(check.warnings)),
        summary="; ".join((summary, f"plan {describe_seal(plan)}", *check.warnings)),
    )


def _as_held(context: StepContext) -> Plan:
    """Lock and read the plan. Raises PRO-007 if it has changed since the case was opened."""
    path, held_sha256 = context.clinical.plan, context.clinical.plan_sha256
    with lock_plan(path) as held:
        if held_sha256 not in (None, held.sha256):
            raise GateFailed(
                "the plan has changed since the case was opened",
                expected=f"SHA-256 {held_sha256}",
                got=held.sha256,
                action="Start a new run with this plan.",
            )
        return parse_plan_bytes(held.content, path.name)


def plan_picture(trajectory: str) -> str:
    """Return the file name of a trajectory's cuts through the CT."""
    return f"{PLAN_PICTURE}{trajectory}.png"


def _keep_cuts(context: StepContext, volume: Volume, plan: Plan, head: HeadEllipsoid) -> tuple[Picture, ...]:
    """Save CT cuts along the planned trajectories for the operator and the report."""
    ways = {one.id: (np.array(one.entry_mm), np.array(one.target_mm)) for one in plan.trajectories}
    middle_mm = np.array(head.centre_mm)
    return tuple(
        context.keep_picture(plan_picture(name), trajectory_cuts(volume, ways, name, middle_mm), name)
        for name in ways
    )


def _confirm_patient(
    context: StepContext, check: PlanCheck, head: HeadEllipsoid, pictures: tuple[Picture, ...]
) -> None:
    """Ask to confirm patient and plan by reading back the patient's identifier. Raises PRO-002.

    The identity is shown with the question, and is in no record. Of the identifier only a part is shown: what
    is typed must come from the wristband, not from the screen.
    """
    scan = read_scan_identity(context.clinical.series)
    identifier = scan.patient.identifier
    if not identifier:
        context.find("the CT series has no patient identifier: there is nothing to read back")
    wristband = ReadBack(
        "the patient's identifier, as on the wristband",
        identifier,
        wrong="is not the identifier in this CT (PatientID). Case, spaces and zeros count. "
        "Answer no if that is what the wristband says.",
        exact=True,
    )
    question = Question(
        Topic.PATIENT,
        "Is this the right patient, and is this the right plan?",
        _describe_plan(check, head),
        read_back=wristband if identifier else None,
        pictures=pictures,
        identity=_identify(scan),
    )
    context.require_yes(question, OTHER_PATIENT)


def _identify(scan: ScanIdentity) -> Identity:
    """Tabulate whose scan it is, with the beginning of the identifier."""
    date, identifier = scan.date, scan.patient.identifier
    if len(date) == DATE_DIGITS and date.isascii() and date.isdigit():
        date = f"{date[:4]}-{date[4:6]}-{date[6:]}"
    rows = (
        ("name", ", ".join(part for part in scan.patient.name.split("^") if part)),
        ("identifier", identifier and f"{identifier[: len(identifier) // 2]}…, the rest as on the wristband"),
        ("date of scan", date),
        ("study", scan.study),
    )
    return Identity(rows=tuple((name, said[:LONGEST_SHOWN] or NOT_GIVEN) for name, said in rows))


def _describe_plan(check: PlanCheck, head: HeadEllipsoid) -> str:
    """Describe the plan anonymously, series and plan by their short numbers. A doubt comes first."""
    plan = check.plan
    return "\n".join(
        (
            *([check.sign_doubt] if check.sign_doubt else []),
            *(
                f"{one.id} {head.side_of(one.entry_mm, one.target_mm)}, {one.depth_mm:.1f} mm deep, "
                f"entry at the {head.half_of(one.entry_mm)}"
                for one in plan.trajectories
            ),
            *([_describe_registering(plan)] if plan.fiducials.has_skin else []),
            f"tool {plan.tool}; instrument {plan.instrument_length_mm:g} mm, "
            f"stand-off {plan.standoff_mm:g} mm",
            f"CT series {short_series_number(plan.series_instance_uid)}, {plan.patient_orientation.value}",
            f"plan {short_plan_number(plan)}, {describe_seal(plan)}",
        )
    )


def _describe_registering(plan: Plan) -> str:
    if not plan.implanted:
        return "registered on the skin: there are no markers"
    return f"registered on the skin and by {format_count(plan.implanted, 'sphere')}"


def _accept_count(
    context: StepContext, check: PlanCheck, localized: LocalizedFiducials
) -> tuple[PlanCheck, int]:
    """If the operator accepts a wrong sphere count, drop it from the check; also return the number to match.

    If there are too many, tracker and matching show which are on the head; if too few, the case continues
    without the missing ones.
    """
    planned, found = check.plan.implanted, len(localized.markers)
    others = tuple(one for one in check.findings if not isinstance(one, WrongMarkerCount))
    if others or check.passed or found < FEWEST_SPHERES:
        return check, planned
    shown = [
        f"{number}: {_place(one)}, radius {one.radius_mm:.2f} mm, quality {one.quality:.2f}, "
        f"odds {one.odds:.2f}"
        for number, one in enumerate(localized.markers, start=1)
    ]
    shown += [f"not taken: {_place(one)}, {one.reason}, odds {one.odds:.2f}" for one in localized.doubtful]
    question = SPHERE_COUNT.question(
        f"the CT shows {found} spheres, {planned} were implanted", "; ".join(shown)
    )
    if context.choose(question) != GO_ON:
        return check, planned
    said = f"the CT shows {found} spheres, {planned} were implanted: the operator continued"
    return replace(check, findings=(), warnings=(*check.warnings, said)), min(planned, found)


def _place(sphere: Marker | DoubtfulSphere) -> str:
    return f"at ({', '.join(f'{value:.1f}' for value in sphere.centre_mm)}) mm"


STEP = StepSpec(
    CheckedPlan,
    "Check the plan",
    Phase.PREOPERATIVE,
    run,
    asks=(Topic.PATIENT,),
    reads=(ImportedCt, LocalizedFiducials),
    preconditions=needs_guide_unmounted,
)
