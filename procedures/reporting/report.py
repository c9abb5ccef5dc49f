"""`report.html`: one self-contained file that shows what a run did and how well.

Everything in it comes from the run's folder: records, journal, kept pictures, and the outcome.
"""

from __future__ import annotations

import base64
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path

from procedures.engine.case import PICTURES_FOLDER
from procedures.engine.journal import Entry
from procedures.engine.run_folder import RunFolder, read_run
from procedures.reporting.figures import cycle_histogram, target_errors
from procedures.reporting.outcome import FinishedRun
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.link_health import LinkHealth
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.registration import RegisteredRobot
from procedures.steps.clinical.relocalization import Relocalization
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tool_change import MountedGuide
from ronna_hw.records import write_whole

REPORT_FILE = "report.html"
STEREO_PICTURES_SHOWN = 5
TEMPLATE = "report.html.j2"


def write_report(folder: Path, outcome: FinishedRun) -> Path:
    """Write the report of a run folder; returns its path."""
    import jinja2

    run = read_run(folder)
    template = resources.files("procedures.reporting").joinpath(TEMPLATE).read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    registrations = run.standing(RegisteredRobot)
    links = _links(run)
    banner = run.opened.get("banner", "")
    text = environment.from_string(template).render(
        outcome=outcome,
        banner=banner,
        theatre=run.opened.get("theatre", ""),
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        localization=run.find(LocalizedFiducials),
        series=run.find(ImportedCt),
        plan=run.find(CheckedPlan),
        registrations=registrations,
        relocalizations=run.standing(Relocalization),
        set_up=run.find(CheckedSetUp),
        links=links,
        confirmations=run.lines(Entry.CONFIRMATION),
        journal=[line for line in run.journal if line["entry"] not in (Entry.MOTION, Entry.MOVED)],
        motions=len(run.lines(Entry.MOTION)),
        records=run.records,
        superseded=run.superseded,
        errors_figure=_inline(target_errors(outcome.targets, bool(banner))) if outcome.targets else "",
        link_figure=_inline(cycle_histogram(links)) if links else "",
        ct_pictures=[_inline(path.read_bytes()) for path in _pictures(folder, "ct-")],
        stereo_pictures=[
            (path.stem, _inline(path.read_bytes()))
            for path in _pictures(folder, "stereo-")[:STEREO_PICTURES_SHOWN]
        ],
        raw=outcome.model_dump_json(indent=1),
    )
    path = folder / REPORT_FILE
    write_whole(path, text.encode())
    return path


def _links(run: RunFolder) -> list[LinkHealth]:
    """Health of the robot link, session by session."""
    retreats = [stored.result.link for stored in run.standing(Retreated)]
    changes = [stored.result.link for stored in run.standing(MountedGuide)]
    return [*changes, *(link for link in retreats if link is not None)]


def _pictures(folder: Path, prefix: str) -> list[Path]:
    return sorted((folder / PICTURES_FOLDER).glob(f"{prefix}*.png"))


def _inline(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()
