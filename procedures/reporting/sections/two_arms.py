"""Two arms: how their bases stand to each other and how well that is known, and each insertion."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from math import dist
from pathlib import Path
from typing import NamedTuple

from procedures.engine.events import ArmsApart, Event
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import AssistedInsertion, KnownBases
from procedures.steps.clinical.two_arms.assisted_insertion import COAXIAL_MM, COAXIAL_RAD
from ronna_hw.arm.clearance.arm_pair import APART_AT_GUIDE_MM, APART_MM
from ronna_hw.bounded_input import InputRefused, read_json_lines
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE

ARMS_APART = b'"arms_apart"'  # in the lines of those events


class AssistedRow(NamedTuple):
    """Insertion by the assistant at a target."""

    target: str
    insertion: AssistedInsertion


@dataclass(frozen=True)
class TwoArms:
    """The bases as measured, and the insertions at the targets."""

    bases: KnownBases
    assisted: tuple[AssistedRow, ...]
    distances: tuple[ArmsApart, ...]  # as displays were told
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
        return min(self.distances, key=lambda one: one.distance_mm, default=None)

    @property
    def force_unsensed(self) -> bool:
        """Whether the instrument was led in by an arm that senses no force."""
        return any(one.insertion.peak_force_N is None for one in self.assisted)


def _read_distances(folder: Path) -> tuple[ArmsApart, ...]:
    """Read the distances between arms among a run's events; what cannot be read is left out."""
    try:
        lines = read_json_lines(folder / EVENTS_FILE).splitlines()
    except (OSError, InputRefused):  # the events are not what a run is judged by
        return ()
    found = []
    for line in lines:
        if ARMS_APART in line:
            with suppress(ValueError):
                found.append(Event.model_validate_json(line).what)
    return tuple(one for one in found if isinstance(one, ArmsApart))


def read_two_arms(reading: RunReading) -> TwoArms | None:
    """Read the section, or return None without two arms whose bases are known."""
    bases = reading.find(KnownBases)
    if bases is None:
        return None
    worked = (
        (str(one.record.trajectory), one.result.assisted) for one in reading.valid_results(ReachedTarget)
    )
    assisted = tuple(AssistedRow(target, insertion) for target, insertion in worked if insertion)
    return TwoArms(bases, assisted, _read_distances(reading.folder))
