"""Which registration each target was or will be reached by: a later one does not apply to finished work."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from procedures.engine.case import Case, Stored, parent_of_kind
from procedures.engine.run_folder import typed
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.registration import Prediction, RegisteredRobot
from ronna_hw.records import Record


@dataclass(frozen=True)
class UsedRegistration:
    """A registration, and the targets that it was or will be used for."""

    stored: Stored[RegisteredRobot]
    targets: tuple[str, ...]

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """At these targets."""
        return tuple(one for one in self.stored.result.predictions if one.target in self.targets)

    @property
    def result(self) -> RegisteredRobot:
        """The registration with only these predictions."""
        return self.stored.result.model_copy(update={"predictions": self.predictions})


def used_registrations(
    registrations: Sequence[Stored[RegisteredRobot]], records: Sequence[Record], gone: Collection[str]
) -> tuple[UsedRegistration, ...]:
    """The registrations of a run that count, in order; `gone` are identifiers of superseded records.

    A finished target follows the parents of its result, whatever is valid since; any other the valid one.
    """
    used = {
        predicted.target: one.record.identifier
        for one in registrations
        if one.record.identifier not in gone
        for predicted in one.result.predictions
    }
    by_name = {record.identifier: record for record in records}
    for record in records:
        if record.kind != ReachedTarget.kind or record.identifier in gone or record.trajectory is None:
            continue
        positioned = parent_of_kind(record, PositionedGuide.kind, by_name)
        by = positioned and parent_of_kind(positioned, RegisteredRobot.kind, by_name)
        if by is not None:
            used[record.trajectory] = by.identifier
    found = (
        UsedRegistration(one, tuple(name for name, by in used.items() if by == one.record.identifier))
        for one in registrations
    )
    return tuple(one for one in found if one.targets)


def registrations_of(case: Case) -> tuple[UsedRegistration, ...]:
    """Those of a case. Raises REC-001, REC-003 for a record that cannot be read."""
    records, stands = case.records, {one.record.identifier for one in case.standing}
    made = [Stored(one, typed(one, RegisteredRobot)) for one in records if one.kind == RegisteredRobot.kind]
    return used_registrations(made, records, {one.identifier for one in records} - stands)
