"""What the lines of a journal say about files and records: their names, and the hashes that they had."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import cast

from ronna_hw.evidence.journal_reading import Entry, Line

REQUEST_FILE = "request.json"
RECORDS_FOLDER = "records"
LASTING = (REQUEST_FILE, f"{RECORDS_FOLDER}/", "case/")  # no longer changed once a run continues
WITH_PORTS = "theatre/theatre.toml"  # written anew by each program that simulates the theatre
NOT_AS_LEFT = "not_as_left"  # in a `restarted` line: files that the end of the run does not vouch for
BEGINNINGS = (Entry.OPENED, Entry.RESTARTED)  # the first line of each program that has the run


def hashes_in(line: Line, field: str) -> dict[str, str]:
    """File names and their hashes in a field of a line; empty if it has none."""
    found = line.get(field)
    return cast("dict[str, str]", dict(found)) if isinstance(found, Mapping) else {}


def names_in(lines: Iterable[Line]) -> int:
    """How many files the lines of a journal name."""
    fields = ("pictures", "files", "inputs", NOT_AS_LEFT)
    return sum(len(hashes_in(line, field)) for line in lines for field in fields)


def closed_files(lines: Sequence[Line]) -> dict[str, str]:
    """Files and hashes of the journal's last `closed` line."""
    closed = next((line for line in reversed(lines) if line["entry"] == Entry.CLOSED), {})
    return hashes_in(closed, "files")


def lasting_files(lines: Sequence[Line]) -> dict[str, str]:
    """Files of a run that goes on which must still be as the journal says, with their hashes.

    Without what results were made from: who goes on compares what it says.
    """
    lasting = {name: sha256 for name, sha256 in closed_files(lines).items() if name.startswith(LASTING)}
    apart = {WITH_PORTS, *made_from(lines)}
    return {name: sha256 for name, sha256 in (lasting | begun_with(lines)).items() if name not in apart}


def superseded_in(lines: Iterable[Line]) -> frozenset[str]:
    """Identifiers of the records that lines of a journal supersede."""
    gone = (line.get("supersedes") for line in lines)
    return frozenset(str(name) for names in gone if isinstance(names, list) for name in names)


def exchanged_inputs(lines: Sequence[Line]) -> Iterator[tuple[str, str]]:
    """Inputs of a closed run that were others at its end than when its standing results were made."""
    at_end = closed_files(lines) | hashes_in(lines[-1], "inputs")
    for name, sha256 in (begun_with(lines) | made_from(lines)).items():
        if at_end.get(name, sha256) != sha256:
            yield name, "exchanged while the run was open: its results were made from another file"


def begun_with(lines: Sequence[Line]) -> dict[str, str]:
    """The files that the last program to open the run began with, with their hashes then."""
    begun = [line for number, line in enumerate(lines) if line["entry"] in BEGINNINGS or not number]
    return hashes_in(begun[-1], "inputs") if begun else {}


def made_from(lines: Sequence[Line]) -> dict[str, str]:
    """The files that the standing results were made from, with their hashes then.

    A finding holds that of a file that was written again since and says the same.
    """
    gone, found = superseded_in(lines), dict[str, str]()
    for line in lines:
        if line["entry"] in (Entry.RESULT, Entry.FINDING) and str(line.get("record")) not in gone:
            found |= hashes_in(line, "inputs")
    return found
