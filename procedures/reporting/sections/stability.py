"""Section on stability: each part of the room that was watched, and when it was last seen unchanged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from procedures.guards import stability
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.results import ConfirmedTarget, KnownBases


class StabilityRow(NamedTuple):
    """Watched subject, when it was last seen, and how it was seen after each target."""

    subject: stability.WatchedSubject
    last_seen_s: float | None  # theatre time
    seen: tuple[stability.SeenUnchanged | None, ...]


@dataclass(frozen=True)
class Stability:
    """Subjects that were watched for changes during the case."""

    targets: tuple[str, ...]  # looked at after these
    rows: tuple[StabilityRow, ...]
    has_assistant: bool
    largest_off_mm: float = LARGEST_OFF_MM

    @property
    def headings(self) -> list[str]:
        """Headings of the columns for the looks."""
        return [f"after {name}: seen, noticed from, mm" for name in self.targets]


def read_stability(reading: RunReading) -> Stability | None:
    """Read the section, or return None before the first look after a target."""
    confirmed = reading.valid_results(ConfirmedTarget)
    if not confirmed:
        return None
    results = {one.record.identifier: one.result for one in confirmed}

    def confirms(record: str, subject: stability.Subject) -> bool:
        return record in results and results[record].confirms(subject)

    last_s = stability.last_seen_s(reading.run.journal, confirms)
    rows = []
    skin = reading.find(SkinInCt)
    for watched in stability.watched_subjects(None if skin is None else len(skin.markers)):
        looks = (one.seen for one in results.values())
        seen = tuple(next((one for one in look if one.subject == watched.subject), None) for look in looks)
        rows.append(StabilityRow(watched, last_s.get(watched.subject), seen))
    return Stability(
        targets=tuple(str(one.record.trajectory) for one in confirmed),
        rows=tuple(rows),
        has_assistant=reading.find(KnownBases) is not None,
    )
