"""Differences between two runs before they began: options, versions, and what they were given."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from procedures.reporting.numbers import NOT_KNOWN
from procedures.reporting.run_options import read_options
from procedures.reporting.run_reading import RunReading
from procedures.reporting.sections.evidence import read_evidence
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.set_up import CheckedSetUp

NOT_SET = "not set"
SHORT_HASH = 12  # hex digits
FAULT_LINES = "fault_lines"
# In the request, and told in other words: the script by its lines, the seed and the strategy by the journal.
TOLD_ELSEWHERE = ("faults", "seed", "strategy")
# Folders, often named after the patient; plan and CT are compared by their content.
UNNAMED = ("case", "plan")


@dataclass(frozen=True)
class Difference:
    """Something that is not the same in both runs, as text; what a run does not have is a dash."""

    name: str
    first: str
    second: str


@dataclass(frozen=True)
class Differences:
    """Differences of one kind, and how many things were compared."""

    title: str
    rows: tuple[Difference, ...]
    compared: int

    @property
    def gist(self) -> str:
        """Summary in a few words."""
        return (
            f"{len(self.rows)} of {self.compared} differ" if self.rows else f"all {self.compared} are equal"
        )


def find_differences(first: RunReading, second: RunReading) -> tuple[Differences, ...]:
    """Compare options, versions and inputs of two runs."""
    kinds = {"Options": _options, "Versions": _versions, "Inputs and devices": _inputs}
    return tuple(_compare(title, read(first), read(second)) for title, read in kinds.items())


def _compare(title: str, first: Mapping[str, str], second: Mapping[str, str]) -> Differences:
    names = tuple(dict.fromkeys((*first, *second)))
    pairs = ((name, first.get(name, NOT_KNOWN), second.get(name, NOT_KNOWN)) for name in names)
    return Differences(title, tuple(Difference(*one) for one in pairs if one[1] != one[2]), len(names))


def _options(reading: RunReading) -> dict[str, str]:
    opened = reading.run.opened
    told = {name: _words(opened.get(name)) for name in ("seed", "strategy", "procedure")}
    asked = read_options(reading.folder).values
    if asked.get("faults") and FAULT_LINES not in asked:  # of a request that does not keep them
        told[FAULT_LINES.replace("_", " ")] = f"those of {asked['faults']}, which were not kept"
    return told | dict(_flatten(asked.items(), without=(*TOLD_ELSEWHERE, *UNNAMED)))


def _flatten(
    items: Iterable[tuple[str, Any]], prefix: str = "", without: tuple[str, ...] = ()
) -> Iterable[tuple[str, str]]:
    for name, value in items:
        if name in without:
            continue
        words = f"{prefix}{name.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _flatten(value.items(), f"{words}, ")
        else:
            yield words, _words(value)


def _words(value: object) -> str:
    if value is None or value == "" or value == []:
        return NOT_SET
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "; ".join(map(str, value)) if isinstance(value, list) else str(value)


def _versions(reading: RunReading) -> dict[str, str]:
    evidence = read_evidence(reading)
    computer = evidence.computer
    processor = _words(reading.run.opened.get("processor"))
    programs = {"software": _words(list(evidence.software)), "python": _words(computer.python)}
    return {**programs, **computer.versions, "system": _words(computer.system), "processor": processor}


def _inputs(reading: RunReading) -> dict[str, str]:
    """Describe plan, CT, calibrations, tools and devices: what is equal has the same content."""
    found = {"plan, SHA-256": _shorten(reading.run.opened.get("plan_sha256"))}
    ct = reading.find(ImportedCt)
    if ct is not None:
        found["voxels of the CT, SHA-256"] = _shorten(ct.voxels_sha256)
    set_up = reading.find(CheckedSetUp)
    if set_up is None:
        return found
    for role, one in set_up.identities.items():
        found[role] = f"{one.vendor} {one.model}, serial {one.serial}, firmware {one.firmware}"
    for name, record in set_up.calibrations.records.items():
        words = name.replace("_", " ")
        found[f"calibration of {words}"] = f"{record.identifier}, {record.stated_error_mm:.3f} mm stated"
    for name, tool in set_up.tools.items():
        found[f"record of {name.replace('_', ' ')}"] = f"{tool.identifier} of {tool.created.date()}"
    return found


def _shorten(digest: object) -> str:
    return f"{str(digest)[:SHORT_HASH]}…" if digest else NOT_SET
