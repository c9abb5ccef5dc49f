"""What results were made from: which stand without it, and which one led to another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from ronna_hw.records import Record


def without_ancestors(standing: Iterable[Record]) -> frozenset[str]:
    """Identifiers of results that are valid while something they descend from is not, in their order.

    They are of trajectories that were finished before something moved.
    """
    records = tuple(standing)
    stands = {record.identifier for record in records}
    past: set[str] = set()
    for record in records:
        if any(parent not in stands or parent in past for parent in record.parents):
            past.add(record.identifier)
    return frozenset(past)


def parent_of_kind(record: Record, kind: str, records: Mapping[str, Record]) -> Record | None:
    """The one of that kind that a record was made from, among `records` by identifier; None without one."""
    return next((parent for parent in _parents(record, records) if parent.kind == kind), None)


def ancestor_of_kind(record: Record, kind: str, records: Mapping[str, Record]) -> Record | None:
    """The nearest of that kind that a record descends from, among `records`; None without one."""
    level = [record]
    while level:
        level = list({one.identifier: one for below in level for one in _parents(below, records)}.values())
        if found := next((one for one in level if one.kind == kind), None):
            return found
    return None


def _parents(record: Record, records: Mapping[str, Record]) -> Iterator[Record]:
    return (records[name] for name in record.parents if name in records)
