"""The report `report.html`: a self-contained record of what a run did, how it ended, and how accurately.

Everything in it comes from the run's folder, however incomplete; only the truth of a simulated theatre comes
from its verifier and is passed in.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from procedures.calibration.base_to_base import LARGEST_ERROR_MM
from procedures.engine.run_folder import targets_in_doubt
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.guards.stability import WATCHED_SUBJECTS, last_seen_s
from procedures.journal.journal import Entry
from procedures.journal.results import StepResult
from procedures.planning.plan_file import describe_seal
from procedures.reporting import numbers
from procedures.reporting.calibration_figures import HeadFigures, load_figures
from procedures.reporting.ending import advise, ending_of, find_run_holder
from procedures.reporting.files import (
    REPORT_FOLDER,
    PostoperativeResult,
    ReportFiles,
    data_url,
    load_check,
    load_picture,
    store_check,
)
from procedures.reporting.kept_truth import store_truth
from procedures.reporting.outcome import RunError, Truth
from procedures.reporting.pictures import (
    clearance_figure,
    link_figure,
    looks_figure,
    sum_histograms,
    target_figure,
    timeline_figure,
)
from procedures.reporting.run_events import advisories, moves, notable_events, questions
from procedures.reporting.run_reading import RunReading, read_for_report
from procedures.reporting.run_statistics import (
    ALGORITHM_PROCESSOR,
    ALGORITHM_S,
    LOCALIZATION,
    OPERATOR_S,
    link_counters,
    timeline,
    times_taken,
)
from procedures.reporting.second_reading import UNREADABLE, as_text, second_reading
from procedures.reporting.tables import TargetRow, plan_rows, target_rows
from procedures.steps.calibration.head_looks import BallMeasurement, ObservedBall
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import (
    ConfirmedTarget,
    KnownBases,
    LeftOutSphere,
    LinkHealth,
    RegisteredRobot,
    Relocalization,
)
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import CheckedTool
from procedures.steps.clinical.two_arms.assisted_insertion import COAXIAL_MM, COAXIAL_RAD
from procedures.workcell.arm_history import MotionKind
from ronna_hw.evidence.manifest import KEPT_TRUTH, PICTURES_FOLDER, REPORT_FILE, read_hashes
from ronna_hw.evidence.unsealed import describe_unsealed_files
from ronna_hw.records import write_atomically
from ronna_hw.roles import ASSISTANT
from ronna_hw.text import escape_controls

NUMBERS_FILE = "numbers.txt"
TEMPLATE = "page.html.j2"


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
    rows = target_rows(reading, truth or Truth())
    if truth is not None:
        store_truth(out, truth)
    after = load_check(reading) if after is None else after
    if after is not None and out != run:
        store_check(out / REPORT_FOLDER, after)
    page = {
        "run": run.name,
        "made": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "opened": reading.run.opened,
        "began": _host_time(reading, 0),
        "ended": _host_time(reading, -1),
        "ending": (ending := ending_of(reading, error, is_writer=_is_held_by_us(run))),
        "advice": advise(ending, is_case=not reading.run.opened.get("procedure")),
        "moves": moves(reading.run.journal),
        "unprinted": [],  # titles, as the page collects them
        "software": list(
            dict.fromkeys(str(one) for line in reading.run.journal if (one := line.get("software")))
        ),
        "computer": next((line for line in reading.log if line.get("event") == "opened"), {}),
        "rows": rows,
        **_plan(reading, files),
        "truth": truth,
        "series": reading.find(ImportedCt),
        "plan": (plan := reading.find(CheckedPlan)),
        "plan_seal": "" if plan is None else describe_seal(plan.plan),
        "localization": reading.find(LocalizedFiducials),
        "tracked": reading.find(GlobalLocalization),
        "relocalizations": reading.standing(Relocalization),
        "registrations": reading.registrations,
        "set_up": reading.find(CheckedSetUp),
        "tools": reading.standing(MountedGuide),
        "bases": reading.find(KnownBases),
        "begun_insertions": _begun_insertions(reading),
        "largest_off_mm": LARGEST_OFF_MM,
        "bases_limit_mm": LARGEST_ERROR_MM,
        "coaxial_mm": COAXIAL_MM,
        "coaxial_rad": COAXIAL_RAD,
        "tool_checks": reading.standing(CheckedTool),
        "worked": reading.standing(ReachedTarget),
        "in_doubt": targets_in_doubt(reading.run.journal),
        "confirmed": (confirmed := reading.standing(ConfirmedTarget)),
        "watched": WATCHED_SUBJECTS,
        "last_seen_s": last_seen_s(
            reading.run.journal,
            lambda record, subject: any(
                one.result.confirms(subject) for one in confirmed if one.record.identifier == record
            ),
        ),
        "links": (links := _links(reading)),
        "link_counters": link_counters(reading.log),
        "questions": questions(reading.run.journal),
        "times": times_taken(reading.run.journal),
        "markers_in_ct": {
            "step": LOCALIZATION,
            "operator_s": OPERATOR_S,
            "algorithm_s": ALGORITHM_S,
            "algorithm_processor": ALGORITHM_PROCESSOR,
        },
        "events": notable_events(reading.run.journal),
        "announced": advisories(reading.run.journal),
        "motions": len(reading.run.lines(Entry.MOTION)),
        "lines": len(reading.run.journal),
        "records": reading.run.records,
        "superseded": reading.run.superseded,
        "plan_pictures": _pictures(reading, "plan-"),
        "ct_pictures": _pictures(reading, "ct-"),
        "stereo_pictures": _pictures(reading, "stereo-"),
        **_figures(reading, files, rows, [health for _, health in links]),
        **_calibration(run, files),
        "after": after,
        **_second_reading(reading, files, rows, out),
        "files": files.written,
        "findings": _findings(reading),
        "left_out": _describe_exclusions(reading),
        "changes": reading.changes,
        "unconfirmed": [*describe_unsealed_files(tuple(reading.run.journal)), *unconfirmed],
        "problems": reading.problems,
    }
    path = out / REPORT_FILE
    write_atomically(path, _template().render(page).encode())
    return path


def _begun_insertions(reading: RunReading) -> list[str]:
    """List the trajectories at which the assistant began to lead an instrument in, in order."""
    motions = reading.run.lines(Entry.MOTION)
    begun = [one for one in motions if one.get("arm") == ASSISTANT and one.get("what") == MotionKind.INSERT]
    return list(dict.fromkeys(str(one.get("trajectory")) for one in begun))


def _is_held_by_us(run: Path) -> bool:
    holder = find_run_holder(run)
    return holder is not None and holder.pid == os.getpid()


def _findings(reading: RunReading) -> list[str]:
    series, spheres = reading.find(ImportedCt), reading.find(LocalizedFiducials)
    plan, set_up = reading.find(CheckedPlan), reading.find(CheckedSetUp)
    observed, look = reading.find(ObservedBall), reading.find(BallMeasurement)
    return [
        *(observed.remarks if observed else ()),
        *([look.reason] if look and look.reason else ()),
        *(f"CT: {one}" for one in (series.warnings if series else ())),
        *(f"CT: {one}" for one in (spheres.warnings if spheres else ())),
        *(f"Plan: {one}" for one in (plan.warnings if plan else ())),
        *(set_up.notices if set_up else ()),
    ]


def _plan(reading: RunReading, files: ReportFiles) -> dict[str, Any]:
    """Return the plan rows and clearance figures of each trajectory, and write the clearances to files."""
    rows = plan_rows(reading)
    pictures = []
    for row in rows:
        if row.motions:
            pictures.append((row.name, clearance_figure(row.name, row.motions)))
            files.text(f"clearance-{row.name}.svg", pictures[-1][1])
            files.clearance(row.name, row.motions)
    return {"plan_rows": rows, "clearance_pictures": pictures}


def _describe_exclusions(reading: RunReading) -> list[str]:
    sentences = []
    models: tuple[type[StepResult], ...] = (Correspondence, CheckedPaths, Relocalization, RegisteredRobot)
    for stored in (stored for model in models for stored in reading.standing(model)):
        where = f" ({stored.record.trajectory})" if stored.record.trajectory else ""
        left_out = stored.result.leaves_out()
        sentences += [f"{name} was left out: {reason}" for name, reason in left_out.items()]
        sentences += [
            f"Sphere {one.fiducial + 1} was left out{where}: {one.reason}" for one in _spheres(stored.result)
        ]
    return sentences


def _spheres(result: StepResult) -> tuple[LeftOutSphere, ...]:
    match result:
        case Correspondence() | Relocalization():
            return result.left_out
        case RegisteredRobot():
            return result.left_out_spheres
    return ()


def _figures(
    reading: RunReading, files: ReportFiles, rows: tuple[TargetRow, ...], links: Sequence[LinkHealth]
) -> dict[str, Any]:
    made = {"target_picture": "", "timeline_picture": "", "link_picture": ""}
    if rows:
        made["target_picture"] = target_figure(rows, bool(reading.run.opened.get("banner")))
        files.text("targets.svg", made["target_picture"])
        files.targets(rows)
    if spans := timeline(reading.run.journal):
        made["timeline_picture"] = timeline_figure(spans)
        files.text("timeline.svg", made["timeline_picture"])
        files.timeline(spans)
    if links and (bins := sum_histograms(links)):
        made["link_picture"] = link_figure(bins)
        files.text("robot_link.svg", made["link_picture"])
        files.link(bins)
    return made


def _calibration(run: Path, files: ReportFiles) -> dict[str, Any]:
    """Return the results of a calibration, check or measurement; empty for a case."""
    found = load_figures(run)
    picture = ""
    if isinstance(found, HeadFigures) and found.looks_px:
        picture = looks_figure(found.looks_px)
        files.text("looks.svg", picture)
        files.looks(found.looks_px)
    return {"figures": [] if found is None else list(found.table()), "looks_picture": picture}


def _second_reading(
    reading: RunReading, files: ReportFiles, rows: tuple[TargetRow, ...], out: Path
) -> dict[str, Any]:
    """Return independently computed target figures, and whether they agree with the report's."""
    if not rows:
        return {"second_text": "", "agree": True}
    try:
        second_rows = second_reading(reading.folder, out / KEPT_TRUTH)
        text = as_text(second_rows)
    except UNREADABLE as error:
        reading.note(f"The figures of the targets could not be read a second time: {error}")
        return {"second_text": "", "agree": False}
    files.text(NUMBERS_FILE, text)
    return {"second_text": text, "agree": second_rows == tuple(row.cells for row in rows)}


def _links(reading: RunReading) -> list[tuple[str, LinkHealth]]:
    """Return the robot link health of each stream, labelled with the mounted tool."""
    changes = [("stereo head", stored.result.link) for stored in reading.standing(MountedGuide)]
    ends: list[tuple[LinkHealth | None, LinkHealth | None]] = [
        (one.result.link, one.result.assistant_link) for one in reading.standing(Retreated)
    ]
    ends += [(one.result.link, one.result.assistant_link) for one in reading.standing(ConfirmedTarget)]
    guides = [("guide", link) for link, _ in ends if link is not None]
    holders = [("holder of the assistant", link) for _, link in ends if link is not None]
    return [*changes, *guides, *holders]


def _host_time(reading: RunReading, place: int) -> str:
    lines = reading.run.journal
    return str(lines[place].get("host_time", ""))[:19].replace("T", " ") if lines else ""


def _pictures(reading: RunReading, prefix: str) -> list[tuple[str, str]]:
    """Return names and data URLs of the images, excluding those of superseded results."""
    gone = {
        name
        for line in reading.run.lines(Entry.RESULT)
        if line.get("record") in reading.run.superseded
        for name in read_hashes(line, "pictures")
    }
    return [
        (path.stem.removeprefix(prefix), data_url(picture))
        for path in sorted((reading.folder / PICTURES_FOLDER).glob(f"{prefix}*.png"))
        if path.is_file() and path.name not in gone and (picture := load_picture(reading, path)) is not None
    ]


def _without_controls(value: Any) -> Any:
    """Escape control characters in plain text. Markup declared safe is generated here and stays unchanged."""
    return "\n".join(map(escape_controls, value.split("\n"))) if type(value) is str else value


@cache  # to compile it takes longer than to fill it
def _template() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("procedures.reporting", "template"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_without_controls,
    )
    environment.filters.update(
        mm=numbers.millimetres,
        degrees=numbers.degrees,
        tenths=numbers.tenths,
        um=numbers.micrometres,
        s=numbers.seconds,
    )
    return environment.get_template(TEMPLATE)
