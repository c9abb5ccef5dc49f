"""Section on the course: events of the run, and the time of each step."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.reporting import run_events, run_statistics
from procedures.reporting.pictures import timeline_figure
from procedures.reporting.run_reading import RunReading
from procedures.steps.calibration.head_looks import BallMeasurement, ObservedBall
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.set_up import CheckedSetUp


@dataclass(frozen=True)
class MarkerSearchTime:
    """Host time of this computer to find the markers in the CT, beside those of the thesis."""

    host_s: float
    processor: str
    operator_s: float = run_statistics.OPERATOR_S
    algorithm_s: float = run_statistics.ALGORITHM_S
    algorithm_processor: str = run_statistics.ALGORITHM_PROCESSOR


@dataclass(frozen=True)
class Course:
    """Findings, incidents, questions and times of a run."""

    findings: tuple[str, ...]
    announced: tuple[run_events.RunEvent, ...]
    events: tuple[run_events.RunEvent, ...]
    questions: tuple[run_events.AskedQuestion, ...]
    spans: tuple[run_statistics.Span, ...]
    timeline_picture: str  # SVG; empty without spans
    times: tuple[run_statistics.TimeTaken, ...]
    processor: str

    @property
    def marker_searches(self) -> tuple[MarkerSearchTime, ...]:
        """Time taken to find the markers in the CT, where that was done."""
        return tuple(
            MarkerSearchTime(one.host_s, self.processor or "a processor that was not recorded")
            for one in self.times
            if one.name == run_statistics.LOCALIZATION and one.host_s is not None
        )


def read_course(reading: RunReading, processor: str) -> Course:
    """Read the section."""
    journal = reading.run.journal
    spans = run_statistics.timeline(journal)
    return Course(
        findings=_find_findings(reading),
        announced=run_events.advisories(journal),
        events=run_events.notable_events(journal),
        questions=run_events.questions(journal),
        spans=spans,
        timeline_picture=timeline_figure(spans) if spans else "",
        times=run_statistics.times_taken(journal),
        processor=processor,
    )


def _find_findings(reading: RunReading) -> tuple[str, ...]:
    series, spheres = reading.find(ImportedCt), reading.find(LocalizedFiducials)
    plan, set_up = reading.find(CheckedPlan), reading.find(CheckedSetUp)
    observed, look = reading.find(ObservedBall), reading.find(BallMeasurement)
    return (
        *(observed.remarks if observed else ()),
        *([look.reason] if look and look.reason else ()),
        *(f"CT: {one}" for one in (series.warnings if series else ())),
        *(f"CT: {one}" for one in (spheres.warnings if spheres else ())),
        *(f"Plan: {one}" for one in (plan.warnings if plan else ())),
        *(set_up.notices if set_up else ()),
    )
