"""Spheres that count in a case, beside their places in the planning CT."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Self

from procedures.engine.case import Stored, results_of
from procedures.imaging.markers import Marker
from procedures.steps.clinical.fiducial_localization import IntraoperativeSpheres, LocalizedFiducials
from ronna_hw.calibration import Numbers3
from ronna_hw.evidence.inspection import Inspection
from ronna_hw.records import Record


@dataclass(frozen=True)
class CaseSpheres:
    """Spheres of the CT or, once the clamped head was scanned, of that scan; both in the CT, LPS mm."""

    used: Stored[LocalizedFiducials]
    planning_ct_mm: Mapping[int, Numbers3]  # by number, from 1; without those that are new since

    @classmethod
    def of(cls, records: Iterable[Record]) -> Self | None:
        """Return the last spheres among records, None without any. Raises REC-001, REC-003."""
        found = results_of(LocalizedFiducials, records)
        return cls(found[-1], _places_in_ct(found)) if found else None

    @classmethod
    def of_registration(cls, registration: Record, run: Inspection) -> Self | None:
        """Return the spheres that a registration was fitted to, by its parents; else the last valid ones.

        Raises REC-001, REC-003.
        """
        found = results_of(LocalizedFiducials, run.records)
        used = [one for one in found if one.record.identifier in registration.parents]
        return cls(used[-1], _places_in_ct(found)) if used else cls.of(run.valid_records)

    @property
    def numbered(self) -> Mapping[int, Marker]:
        """Spheres by number, from 1; none of a case that registers on the skin alone."""
        return self.used.result.numbered

    @property
    def are_scanned(self) -> bool:
        """Whether they are those of a scan of the clamped head."""
        return isinstance(self.used.result, IntraoperativeSpheres)


def _places_in_ct(found: Iterable[Stored[LocalizedFiducials]]) -> dict[int, Numbers3]:
    in_ct = [one.result for one in found if one.record.kind == LocalizedFiducials.kind]
    return {number: marker.centre_mm for number, marker in in_ct[-1].numbered.items()} if in_ct else {}
