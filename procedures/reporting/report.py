"""`report.html`: one self-contained file that shows what a run did and how well.

Everything in it comes from the run's folder: records, journal, kept pictures, and the outcome.
"""

from __future__ import annotations

import base64
import json
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any

from procedures.engine.case import PICTURES_FOLDER, RECORDS_FOLDER
from procedures.engine.journal import JOURNAL_FILE, Entry, read_journal
from procedures.reporting.figures import cycle_histogram, target_errors
from ronna_hw.records import Record, read_record, write_whole

REPORT_FILE = "report.html"
STEREO_PICTURES_SHOWN = 5
TEMPLATE = "report.html.j2"


def write_report(folder: Path, outcome: dict[str, Any]) -> Path:
    """Write the report of a run folder; returns its path."""
    import jinja2

    records = [read_record(path) for path in sorted((folder / RECORDS_FOLDER).glob("*.json"))]
    journal = list(read_journal(folder / JOURNAL_FILE))
    template = resources.files("procedures.reporting").joinpath(TEMPLATE).read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    by_kind = _by_kind(records)
    sessions = [record.payload["link"] for record in records if "link" in record.payload]
    banner = journal[0].get("banner", "") if journal else ""
    text = environment.from_string(template).render(
        outcome=outcome,
        banner=banner,
        theatre=journal[0].get("theatre", "") if journal else "",
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        localization=_payload(by_kind, "fiducial_localization"),
        series=_payload(by_kind, "ct_import"),
        plan=_payload(by_kind, "plan_check"),
        correspondence=_payload(by_kind, "correspondence"),
        registrations=[record.payload for record in by_kind.get("registration", [])],
        relocalizations=[record.payload for record in by_kind.get("relocalization", [])],
        set_up=_payload(by_kind, "set_up"),
        sessions=sessions,
        confirmations=[line for line in journal if line["entry"] == Entry.CONFIRMATION],
        journal=journal,
        records=records,
        errors_figure=_inline(target_errors(outcome["targets"], bool(banner))) if outcome["targets"] else "",
        link_figure=_inline(cycle_histogram(sessions)) if sessions else "",
        ct_pictures=[_inline(path.read_bytes()) for path in _pictures(folder, "ct-")],
        stereo_pictures=[
            (path.stem, _inline(path.read_bytes()))
            for path in _pictures(folder, "stereo-")[:STEREO_PICTURES_SHOWN]
        ],
        raw=json.dumps(outcome, indent=1),
    )
    path = folder / REPORT_FILE
    write_whole(path, text.encode())
    return path


def _by_kind(records: list[Record]) -> dict[str, list[Record]]:
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(record.kind, []).append(record)
    return groups


def _payload(groups: dict[str, list[Record]], kind: str) -> dict[str, Any] | None:
    return groups[kind][-1].payload if kind in groups else None


def _pictures(folder: Path, prefix: str) -> list[Path]:
    return sorted((folder / PICTURES_FOLDER).glob(f"{prefix}*.png"))


def _inline(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()
