"""The report `report.html`: a self-contained record of what a run did, how it ended, and how accurately.

Everything in it comes from the run's folder, however incomplete; only the truth of a simulated theatre comes
from its verifier and is passed in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from procedures.reporting import numbers
from procedures.reporting.files import (
    REPORT_FOLDER,
    PostoperativeResult,
    ReportFiles,
    clearance_columns,
    load_check,
    store_check,
    target_columns,
)
from procedures.reporting.kept_truth import store_truth
from procedures.reporting.outcome import RunError, Truth
from procedures.reporting.page import Page, read_page
from procedures.reporting.run_reading import read_for_report
from ronna_hw.evidence.manifest import REPORT_FILE
from ronna_hw.records import write_atomically
from ronna_hw.text import escape_controls

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
    if truth is not None:
        store_truth(out, truth)
    after = load_check(reading) if after is None else after
    if after is not None and out != run:
        store_check(out / REPORT_FOLDER, after)
    page = read_page(reading, truth, error, after, unconfirmed)
    _write_drawings(files, page)
    path = out / REPORT_FILE
    # The templates collect the titles of what is not on paper in `unprinted`.
    html = _template().render(page=page, files=files.written, unprinted=[])
    write_atomically(path, html.encode())
    return path


def _write_drawings(files: ReportFiles, page: Page) -> None:
    """Write each drawing and its data to files."""
    if page.plan is not None:
        motions = {row.name: row.motions for row in page.plan.rows}
        for name, svg in page.plan.clearances:
            files.drawing(f"clearance-{name}", svg, clearance_columns(motions[name]))
    if page.targets is not None:
        files.drawing("targets", page.targets.picture, target_columns(page.targets.table.rows))
    if page.course.spans:
        files.drawing("timeline", page.course.timeline_picture, list(map(asdict, page.course.spans)))
    if page.devices.link_bins:
        bins = [one._asdict() for one in page.devices.link_bins]
        files.drawing("robot_link", page.devices.link_picture, bins)
    if page.calibration.looks:
        looks = [{"look": number} | one._asdict() for number, one in enumerate(page.calibration.looks, 1)]
        files.drawing("looks", page.calibration.looks_picture, looks)


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
        point=numbers.point,
        degrees=numbers.degrees,
        tenths=numbers.tenths,
        um=numbers.micrometres,
        s=numbers.seconds,
    )
    return environment.get_template(TEMPLATE)
