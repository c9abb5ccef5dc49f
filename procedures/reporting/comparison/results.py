"""Results of two runs beside each other: steps and times, targets, registrations, findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import degrees
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.reporting.outcome import Truth
from procedures.reporting.pictures import step_of
from procedures.reporting.run_reading import RunReading, UsedRegistration
from procedures.reporting.run_statistics import STEP, Span, TimeTaken, timeline, times_taken
from procedures.reporting.sections.course import Course
from procedures.reporting.tables import TargetRow, target_rows
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import RegisteredRobot

T = TypeVar("T")
NOT_REACHED = "not reached"


class Pair(NamedTuple, Generic[T]):
    """A value of the first run and of the second."""

    first: T
    second: T


def difference(pair: Pair[float | None]) -> float | None:
    """Return the second value less the first, or None where one is not known."""
    return None if pair.first is None or pair.second is None else pair.second - pair.first


@dataclass(frozen=True)
class ComparedStep:
    """A step of all trajectories in both runs: how it ended, and how long it took."""

    name: str
    ended: Pair[str]
    theatre_s: Pair[float | None]
    host_s: Pair[float | None]

    @property
    def longer_s(self) -> float | None:
        """By how much theatre time the second run took longer."""
        return difference(self.theatre_s)


def compare_steps(first: RunReading, second: RunReading) -> tuple[ComparedStep, ...]:
    """Compare the steps of two runs, in the order of the first that has them."""
    ended, taken = _both(first, second, _step_ends), _both(first, second, _step_times)
    names = dict.fromkeys((*ended.first, *ended.second))
    return tuple(
        ComparedStep(
            name,
            Pair(ended.first.get(name, NOT_REACHED), ended.second.get(name, NOT_REACHED)),
            Pair(*(one[name].theatre_s if name in one else None for one in taken)),
            Pair(*(one[name].host_s if name in one else None for one in taken)),
        )
        for name in names
    )


def _both(first: RunReading, second: RunReading, read: Callable[[RunReading], T]) -> Pair[T]:
    return Pair(read(first), read(second))


def spans_of(reading: RunReading) -> tuple[Span, ...]:
    """Return the timeline of a run."""
    return timeline(reading.run.journal)


def _step_ends(reading: RunReading) -> dict[str, str]:
    """Describe how each step ended: each way once, with its count if there are several."""
    ends: dict[str, list[str]] = {}
    for span in spans_of(reading):
        if span.kind == "step":
            ends.setdefault(step_of(span), []).append(span.ended)
    return {name: ", ".join(_count_each(each)) for name, each in ends.items()}


def _count_each(words: Sequence[str]) -> Iterable[str]:
    for word in dict.fromkeys(words):
        count = words.count(word)
        yield f"{count} × {word}" if count > 1 else word


def _step_times(reading: RunReading) -> dict[str, TimeTaken]:
    return {one.name: one for one in times_taken(reading.run.journal) if one.kind == STEP}


@dataclass(frozen=True)
class ComparedTarget:
    """A target in both runs; None where a run has no registration for it."""

    name: str
    rows: Pair[TargetRow | None]
    apart_mm: float | None  # between the planned targets, in the CT; None with another CT

    @property
    def error_mm(self) -> Pair[float | None]:
        """Known errors."""
        return Pair(*(None if row is None else row.error_mm for row in self.rows))

    @property
    def limit_mm(self) -> Pair[float | None]:
        """Limits of the predicted errors."""
        return Pair(*(None if row is None else row.predicted.limit_mm for row in self.rows))


def compare_targets(first: RunReading, second: RunReading) -> tuple[ComparedTarget, ...]:
    """Compare the targets of two runs by name."""
    rows = _both(first, second, _target_rows)
    places = _both(first, second, _planned_targets)
    is_same_ct = _is_same_ct(first, second)
    names = dict.fromkeys((*places.first, *places.second, *rows.first, *rows.second))
    found = []
    for name in names:
        both = name in places.first and name in places.second and is_same_ct
        apart_mm = _distance_mm(places.first[name], places.second[name]) if both else None
        found.append(ComparedTarget(name, Pair(rows.first.get(name), rows.second.get(name)), apart_mm))
    return tuple(found)


def _target_rows(reading: RunReading) -> dict[str, TargetRow]:
    return {row.target: row for row in target_rows(reading, reading.truth or Truth())}


def _planned_targets(reading: RunReading) -> dict[str, tuple[float, float, float]]:
    checked = reading.find(CheckedPlan)
    return {} if checked is None else {one.id: one.target_mm for one in checked.plan.trajectories}


def _distance_mm(first: ArrayLike, second: ArrayLike) -> float:
    return float(np.linalg.norm(np.subtract(first, second)))


def _is_same_ct(first: RunReading, second: RunReading) -> bool:
    series = _both(first, second, lambda one: one.find(ImportedCt))
    return (
        series.first is not None
        and series.second is not None
        and series.first.series_instance_uid == series.second.series_instance_uid
    )


@dataclass(frozen=True)
class ComparedRegistration:
    """Registrations of both runs for a target, and the distance of the places to which they send the arm."""

    target: str
    fits: Pair[RegisteredRobot | None]
    apart_mm: float | None  # None with another CT
    turned_deg: float | None

    @property
    def pairs(self) -> Pair[int | None]:
        """Numbers of spheres that the fits used."""
        return Pair(*(None if fit is None else fit.pairs for fit in self.fits))

    @property
    def farthest_mm(self) -> Pair[float | None]:
        """Largest distance of a sphere from the stereo head's point; None without a point."""
        return Pair(*map(_farthest_mm, self.fits))


def _farthest_mm(fit: RegisteredRobot | None) -> float | None:
    rows = () if fit is None else fit.two_way.ct_to_room
    return max((row.stereo_residual_mm for row in rows if row.stereo_residual_mm is not None), default=None)


def compare_registrations(first: RunReading, second: RunReading) -> tuple[ComparedRegistration, ...]:
    """Compare the registrations that were used for each target."""
    used, places = _both(first, second, _registrations), _both(first, second, _planned_targets)
    is_same_ct = _is_same_ct(first, second)
    rows = []
    for name in dict.fromkeys((*used.first, *used.second)):
        one, other = used.first.get(name), used.second.get(name)
        apart_mm = turned_deg = None
        if one is not None and other is not None and is_same_ct and name in places.first:
            poses = one.result.robot_from_ct_at(name), other.result.robot_from_ct_at(name)
            target_mm = places.first[name]
            apart_mm = _distance_mm(poses[0].apply(target_mm), poses[1].apply(target_mm))
            turn = Rotation.from_matrix(poses[0].rotation_matrix.T @ poses[1].rotation_matrix)
            turned_deg = degrees(turn.magnitude())
        fits = Pair(*(None if used is None else used.result for used in (one, other)))
        rows.append(ComparedRegistration(name, fits, apart_mm, turned_deg))
    return tuple(rows)


def _registrations(reading: RunReading) -> dict[str, UsedRegistration]:
    return {name: one for one in reading.registrations for name in one.targets}


@dataclass(frozen=True)
class ComparedTexts:
    """Texts that only one run has, and those of both."""

    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    both: tuple[str, ...]


def compare_findings(first: Course, second: Course) -> ComparedTexts:
    """Compare what was found and what went wrong, by its text; times are not compared."""
    one, other = _texts(first), _texts(second)
    return ComparedTexts(
        tuple(text for text in one if text not in other),
        tuple(text for text in other if text not in one),
        tuple(text for text in one if text in other),
    )


def _texts(course: Course) -> tuple[str, ...]:
    told = (
        f"{one.step}: {one.text}" if one.step else one.text for one in (*course.announced, *course.events)
    )
    return tuple(dict.fromkeys((*course.findings, *told)))
