"""Page that compares two runs. Both folders are only read; what a run did not come to is empty."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from procedures.imaging.trajectory_cuts import PLAN_PICTURE
from procedures.reporting.comparison.differences import Differences, find_differences
from procedures.reporting.comparison.drawing import compared_targets_figure
from procedures.reporting.comparison.results import (
    ComparedRegistration,
    ComparedStep,
    ComparedTarget,
    ComparedTexts,
    Pair,
    compare_findings,
    compare_registrations,
    compare_steps,
    compare_targets,
    spans_of,
)
from procedures.reporting.ending import Ending, ending_of
from procedures.reporting.files import load_pictures
from procedures.reporting.outcome import Truth
from procedures.reporting.page_file import write_page
from procedures.reporting.page_templates import load_template
from procedures.reporting.pictures import step_of, timeline_figure
from procedures.reporting.run_reading import RunReading, read_for_report
from procedures.reporting.sections.course import read_course
from procedures.reporting.sections.header import RunOpening, read_header
from procedures.reporting.sections.plan import read_plan
from procedures.reporting.tables import TargetTable, target_rows
from procedures.steps.catalogue import name_every_step
from procedures.steps.clinical.ct_import import ImportedCt
from ronna_hw.notebook_html import table_html

TEMPLATE = "comparison.html.j2"
FIRST, SECOND = "A", "B"  # as the page calls the runs


@dataclass(frozen=True)
class ComparedRun:
    """One of the two runs, as the head of the page shows it."""

    letter: str
    name: str
    origin: str
    banner: str
    ending: Ending
    problems: tuple[str, ...]


class PicturePair(NamedTuple):
    """Pictures of one trajectory in both runs as data URLs; None for a run without it."""

    name: str
    first: str | None
    second: str | None


@dataclass(frozen=True, repr=False)
class RunComparison:
    """Two runs beside each other, for a page, a notebook, or further work in Python."""

    runs: Pair[ComparedRun]
    differences: tuple[Differences, ...]
    steps: tuple[ComparedStep, ...]
    targets: tuple[ComparedTarget, ...]
    registrations: tuple[ComparedRegistration, ...]
    findings: ComparedTexts
    targets_picture: str  # SVG; empty without a prediction
    timelines: Pair[str]  # SVG, on one scale of time
    plan_pictures: tuple[PicturePair, ...]  # of trajectories whose pictures differ
    has_two_cts: bool = False  # whether both CTs are known and are not the same

    def __repr__(self) -> str:
        names = " and ".join(f"{one.letter} {one.name} ({one.ending.word})" for one in self.runs)
        return f"{names}; {'; '.join(f'{one.title}: {one.gist}' for one in self.differences)}"

    @property
    def total_s(self) -> Pair[float]:
        """Theatre time of all steps."""
        return Pair(*(sum(one.theatre_s[at] or 0.0 for one in self.steps) for at in (0, 1)))

    @property
    def step_titles(self) -> dict[str, str]:
        """Titles of the steps of a case, by their names in the journal."""
        return {name: step.title for name, step in name_every_step().items()}

    def write(self, out: str | os.PathLike[str]) -> Path:
        """Write the page to a file and return its path. Raises ARG-001, CLI-005 in a run, OSError."""
        return write_page(out, load_template(TEMPLATE).render(compared=self, unprinted=[]))

    def as_payload(self) -> dict[str, Any]:
        """Return what differs and the errors at the targets as plain data for JSON."""
        return {
            "runs": [{"run": one.name, "outcome": one.ending.word} for one in self.runs],
            "differences": [asdict(row) for part in self.differences for row in part.rows],
            "targets": [
                {"id": one.name, "error_mm": list(one.error_mm), "limit_mm": list(one.limit_mm)}
                for one in self.targets
            ],
            "theatre_s": list(self.total_s),
        }

    def _repr_html_(self) -> str:
        """Return the differences and the targets as a notebook shows them."""
        names = [f"{one.letter}: {one.name}, {one.ending.word}" for one in self.runs]
        rows = [(one.name, one.first, one.second) for part in self.differences for one in part.rows]
        before = table_html(("different", *names), rows, len(rows))
        heads = ["target"] + [f"{what} mm {run}" for what in ("error", "limit") for run in (FIRST, SECOND)]
        cells = [(one.name, *map(_or_empty, (*one.error_mm, *one.limit_mm))) for one in self.targets]
        return before + table_html(heads, cells, len(cells))


def _or_empty(value: float | None) -> float | str:
    return "" if value is None else value


def compare_runs(first: Path, second: Path) -> RunComparison:
    """Compare two run folders. Damaged files never raise errors; what cannot be relied on is named."""
    readings = Pair(read_for_report(first), read_for_report(second))
    courses = [read_course(one, "") for one in readings]
    targets = compare_targets(*readings)
    return RunComparison(
        runs=Pair(*map(_describe_run, (FIRST, SECOND), readings)),
        differences=find_differences(*readings),
        steps=compare_steps(*readings),
        targets=targets,
        registrations=compare_registrations(*readings),
        findings=compare_findings(*courses),
        targets_picture=compared_targets_figure(targets, (FIRST, SECOND)),
        timelines=_draw_timelines(readings),
        plan_pictures=_find_different_pictures(readings),
        has_two_cts=_have_two_cts(readings),
    )


def _have_two_cts(readings: Pair[RunReading]) -> bool:
    first, second = (one.find(ImportedCt) for one in readings)
    return first is not None and second is not None and first.voxels_sha256 != second.voxels_sha256


def _describe_run(letter: str, reading: RunReading) -> ComparedRun:
    opening, plan = RunOpening.of(reading.run.opened), read_plan(reading)
    table = TargetTable(target_rows(reading, reading.truth or Truth()))
    header = read_header(reading.run.name, reading, opening, table, () if plan is None else plan.rows)
    problems = (*reading.changes, *reading.problems)
    return ComparedRun(letter, header.run, header.origin, header.banner, ending_of(reading), problems)


def _draw_timelines(readings: Pair[RunReading]) -> Pair[str]:
    """Draw both timelines with the same rows and the same scale."""
    both = [spans_of(one) for one in readings]
    ends_s = [span.end_s for spans in both for span in spans]
    steps = list(dict.fromkeys(step_of(span) for spans in both for span in spans))
    return Pair(*(timeline_figure(one, until_s=max(ends_s), steps=steps) if one else "" for one in both))


def _find_different_pictures(readings: Pair[RunReading]) -> tuple[PicturePair, ...]:
    """Return the cuts along the trajectories where the two runs do not have the same picture."""
    first, second = (dict(load_pictures(one, PLAN_PICTURE)) for one in readings)
    pairs = (PicturePair(name, first.get(name), second.get(name)) for name in sorted({**first, **second}))
    return tuple(one for one in pairs if one.first != one.second)
