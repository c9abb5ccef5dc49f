"""First page of a run's report as a DICOM Secondary Capture, which every archive shows.

It names no patient: trajectories have their exported labels, and words of a person are not on it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.uid import SecondaryCaptureImageStorage

from procedures.engine.run_folder import targets_in_doubt
from procedures.exchange.case_results import REGISTRATION_OF, CaseResults
from procedures.exchange.dicom_objects import (
    BODY_PART,
    NO_MEDICAL_DEVICE,
    PAGE,
    Origin,
    date_content,
    new_object,
)
from procedures.operator.margin import MarginVerdict
from procedures.reporting.ending import ADVICE
from procedures.reporting.numbers import NOT_KNOWN, millimetres
from procedures.reporting.tables import TargetRow

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_IN, DOTS_PER_INCH = (8.27, 11.69), 110  # A4; its small print is readable on a workstation
INK, FAINT = "#1b1f22", "#5a646a"
COLOURS = {"ok": "#2c6e4f", "warn": "#8a5200", "bad": "#b3261e"}
BITS = 8
LEFT, RIGHT, LINE = 0.08, 0.92, 0.022  # shares of the page
COLUMNS = (0.08, 0.30, 0.45, 0.49, 0.77, 0.92)  # right edges; of target and verdict the left ones
TARGET, VERDICT, FOUND = 0, 3, 5  # columns
HEADINGS = ("target", "error mm", "accepted mm", "verdict", "predicted mm", "found later mm")
MOST_ROWS = 24  # below them the notes have room
WIDEST_LINE = 88  # characters


def report_page(pixels: NDArray[np.uint8], origin: Origin) -> Dataset:
    """Build the Secondary Capture object of a drawn page."""
    made = new_object(origin, SecondaryCaptureImageStorage, PAGE, "report, first page")
    date_content(made)
    made.BodyPartExamined, made.PatientOrientation = BODY_PART, ""
    made.ConversionType, made.ImageType = "WSD", ["DERIVED", "SECONDARY"]
    made.BurnedInAnnotation = "NO"  # it identifies nobody
    made.Rows, made.Columns, made.SamplesPerPixel = pixels.shape
    made.PhotometricInterpretation, made.PlanarConfiguration = "RGB", 0
    made.BitsAllocated, made.BitsStored, made.HighBit, made.PixelRepresentation = BITS, BITS, BITS - 1, 0
    content = pixels.tobytes()
    made.PixelData = content + b"\0" * (len(content) % 2)
    made["PixelData"].VR = "OB"
    return made


def draw_page(results: CaseResults, made: datetime) -> NDArray[np.uint8]:
    """Draw the page as pixels (rows, columns, 3); the last result was `made` then."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_IN, dpi=DOTS_PER_INCH, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    bar = "SIMULATED THEATRE" if results.simulated else "Robot-guided case"
    banner = {"facecolor": COLOURS["bad"], "edgecolor": "none", "boxstyle": "square,pad=0.7"}
    figure.text(LEFT, 0.945, f"{bar} · {NO_MEDICAL_DEVICE}", color="white", size=12, bbox=banner)
    ending = results.ending
    code = f" ({ending.code})" if ending.code else ""
    figure.text(LEFT, 0.885, f"{ending.word.capitalize()}{code}", color=INK, size=22, weight="bold")
    height = _write(figure, 0.852, ADVICE.get(ending.word, ""))
    height = _draw_table(figure, height - LINE, results)
    height = _write(figure, height - LINE, *_notes(results))
    dated = f"{made:%Y-%m-%d %H:%M} UTC"
    origins = (f"CT series {results.ct.series}", f"last result {dated}; names no patient")
    for place, text in enumerate(origins):
        figure.text(LEFT, 0.06 - place * LINE, text, color=FAINT, size=8)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, :3])


def _draw_table(figure: Figure, height: float, results: CaseResults) -> float:
    """Draw a row for each registered target, and return the height below it."""
    rows = results.targets.rows
    if not rows:
        return _write(figure, height, "No trajectory was registered.")
    doubts = targets_in_doubt(results.run.journal)
    _draw_row(figure, height, HEADINGS, dict.fromkeys(range(len(HEADINGS)), FAINT))
    for row in rows[:MOST_ROWS]:
        height -= LINE
        verdict, found_mm = row.verdict, _found_mm(results, row)
        words = f"{verdict or NOT_KNOWN}{', in doubt' if row.target in doubts else ''}"
        cells = (
            results.labels[row.target],
            millimetres(row.known_mm),
            millimetres(row.margin_mm),
            words,
            millimetres(row.predicted.limit_mm),
            millimetres(found_mm),
        )
        colours = {VERDICT: _colour(verdict, row.target in doubts)}
        if found_mm is not None and row.margin_mm is not None and found_mm > row.margin_mm:
            colours[FOUND] = COLOURS["bad"]
        _draw_row(figure, height, cells, colours)
    if len(rows) > MOST_ROWS:
        height = _write(figure, height - LINE, f"and {len(rows) - MOST_ROWS} more, in the full report")
    return height - LINE


def _draw_row(figure: Figure, height: float, cells: Sequence[str], colours: Mapping[int, str]) -> None:
    for place, (across, text) in enumerate(zip(COLUMNS, cells, strict=True)):
        side = "left" if place in (TARGET, VERDICT) else "right"
        figure.text(across, height, text, size=9, color=colours.get(place, INK), ha=side)


def _write(figure: Figure, height: float, *paragraphs: str) -> float:
    """Write paragraphs below a height, and return the height below them."""
    for paragraph in paragraphs:
        for line in textwrap.wrap(paragraph, WIDEST_LINE):
            figure.text(LEFT, height, line, color=INK, size=9)
            height -= LINE
    return height


def _colour(verdict: MarginVerdict | None, in_doubt: bool) -> str:
    if verdict is None:
        return FAINT
    return COLOURS["warn" if in_doubt and verdict.colour == "ok" else verdict.colour]


def _found_mm(results: CaseResults, row: TargetRow) -> float | None:
    """Return the error found after the operation, of a drilled hole that across the trajectory."""
    found = results.found.get(row.target)
    if found is None:
        return None
    return found.lateral_mm if found.target_error_mm is None else found.target_error_mm


def _notes(results: CaseResults) -> list[str]:
    """Return what the run lacks, and what the columns of the table mean for it."""
    table = results.targets
    missing = {what: why for what, why in results.absent().items() if what.startswith(REGISTRATION_OF)}
    without = [f"{what.removeprefix(REGISTRATION_OF)} ({why})" for what, why in missing.items()]
    lacking = [f"Without a registration: {', '.join(without)}."] if without else []
    unreached = [results.labels[row.target] for row in table.rows if row.target not in results.reached]
    lacking += [f"Not reached: {', '.join(unreached)}."] if unreached else []
    if not table.rows:
        return lacking
    notes = [
        *lacking,
        f"Predicted: the radius that holds the error with {table.prediction.confidence:.0%} probability, "
        "computed before the guide moved; not a measurement. Accepted: the margin of the plan.",
        "Found later: from the planned target to the tip in the CT after the operation; of a drilled hole, "
        "which has no tip, across the trajectory.",
        "None of them includes brain shift once the skull is open.",
    ]
    if table.errors_mm:
        notes.insert(0, "Error: from the planned target to the tip in the simulated truth.")
    elif table.any_measured:
        notes.insert(0, "Error: measured by the stereo head in place of the guide, on a phantom.")
    else:
        notes.insert(0, "Error: the true position of the tip is not known.")
    return notes
