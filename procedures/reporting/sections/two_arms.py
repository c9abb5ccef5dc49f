"""Two arms: their bases and how well those are known, the ways of both, and each insertion."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import dist
from pathlib import Path
from typing import NamedTuple

from procedures.calibration.base_to_base import LARGEST_ERROR_MM
from procedures.engine.events import ArmsApart, Event
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.journal.journal import Entry, Line
from procedures.reporting.arm_ways import ArmWay, list_arm_ways
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import AssistedInsertion, CranialOpening, KnownBases
from procedures.steps.clinical.two_arms.over_guide import COAXIAL_MM, COAXIAL_RAD
from ronna_hw.arm.clearance.arm_pair import APART_AT_GUIDE_MM, APART_MM
from ronna_hw.bounded_input import InputRefused, read_json_lines
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE

ARMS_APART = b'"arms_apart"'  # in the lines of those events


class AssistedRow(NamedTuple):
    """Insertion by the assistant at a target."""

    target: str
    insertion: AssistedInsertion


class OpeningRow(NamedTuple):
    """Opening of the skull by the assistant's drill at a target."""

    target: str
    opening: CranialOpening


class TimedDistance(NamedTuple):
    """Distance between the arms as displays were told it."""

    theatre_time_s: float
    seen: ArmsApart


class WayRow(NamedTuple):
    """Way of an arm along an axis, and how close the arms were seen on it and on the way home."""

    way: ArmWay
    apart_mm: float | None


@dataclass(frozen=True)
class TwoArms:
    """The bases as measured, the ways of both arms, and the insertions at the targets."""

    bases: KnownBases
    assisted: tuple[AssistedRow, ...]
    ways: tuple[WayRow, ...]
    distances: tuple[TimedDistance, ...]
    openings: tuple[OpeningRow, ...] = ()
    bases_limit_mm: float = LARGEST_ERROR_MM
    coaxial_mm: float = COAXIAL_MM
    coaxial_rad: float = COAXIAL_RAD
    largest_off_mm: float = LARGEST_OFF_MM
    apart_mm: float = APART_MM
    apart_at_guide_mm: float = APART_AT_GUIDE_MM

    @property
    def between_bases_mm(self) -> float:
        """Distance between the bases of both arms."""
        return dist(self.bases.robot_from_base.translation_mm, (0.0, 0.0, 0.0))

    @property
    def closest(self) -> ArmsApart | None:
        """Smallest distance between the arms of which displays were told."""
        found = min(self.distances, key=lambda one: one.seen.distance_mm, default=None)
        return None if found is None else found.seen

    @property
    def force_unsensed(self) -> bool:
        """Whether the instrument was led in by an arm that senses no force."""
        return any(one.insertion.peak_force_N is None for one in self.assisted)


def _read_distances(folder: Path) -> tuple[TimedDistance, ...]:
    """Read the distances between arms among a run's events; what cannot be read is left out."""
    try:
        lines = read_json_lines(folder / EVENTS_FILE).splitlines()
    except (OSError, InputRefused):  # the events are not what a run is judged by
        return ()
    found = []
    for line in lines:
        if ARMS_APART in line:
            with suppress(ValueError):
                event = Event.model_validate_json(line)
                if isinstance(event.what, ArmsApart):
                    found.append(TimedDistance(event.theatre_time_s, event.what))
    return tuple(found)


def _read_openings(journal: Sequence[Line]) -> tuple[OpeningRow, ...]:
    """Read the last opening at each target, also where the step did not end. Raises REC-003."""
    stages = [line for line in journal if line["entry"] == Entry.STAGE and line.get("opening")]
    last = {str(line["trajectory"]): line["opening"] for line in stages}
    return tuple(OpeningRow(target, CranialOpening.of_stage(one, target)) for target, one in last.items())


def _find_closest_mm(way: ArmWay, distances: Sequence[TimedDistance]) -> float | None:
    """Return the smallest distance of which displays were told on a way, or None if of none."""
    end_s = way.home_s or way.end_s or way.begin_s
    on_way = (one.seen.distance_mm for one in distances if way.begin_s <= one.theatre_time_s <= end_s)
    return min(on_way, default=None)


def read_two_arms(reading: RunReading) -> TwoArms | None:
    """Read the section, or return None without two arms whose bases are known."""
    bases = reading.find(KnownBases)
    if bases is None:
        return None
    worked = [(str(one.record.trajectory), one.result) for one in reading.valid_results(ReachedTarget)]
    assisted = tuple(AssistedRow(target, one.assisted) for target, one in worked if one.assisted)
    openings = _read_openings(reading.run.journal)
    distances = _read_distances(reading.folder)
    ways = (WayRow(way, _find_closest_mm(way, distances)) for way in list_arm_ways(reading.run.journal))
    return TwoArms(bases, assisted, tuple(ways), distances, openings)
