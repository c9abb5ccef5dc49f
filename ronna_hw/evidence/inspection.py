"""The integrity check of a run folder: nothing in it is changed, missing, added, replaced or foreign.

Journal and seal describe the folder as the run left it. A killed run has neither its last line nor a seal. It
is checked as far as it goes; findings that only its end could confirm are `unfinished`, not changes.
"""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from ronna_hw.bounded_input import InputRefused, read_json_lines
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, Chain, Entry, Line, RunChanged, chain_until_broken
from ronna_hw.evidence.manifest import (
    RECORDS_FOLDER,
    REQUEST_FILE,
    SEAL_FILE,
    TRUTH_FILES,
    Manifest,
    Seal,
    count_names,
    files_of,
    is_later,
    is_made_anew,
    read_seal,
    sha256_of,
)
from ronna_hw.records import PARTIAL, BadRecord, Record, read_record
from ronna_hw.text import printable

MOST_NAMES = 100_000  # of files in a journal: a run and its CT have some thousands
LARGEST_INPUTS_BYTES = 8_000_000_000  # four times the largest CT that is read
SHOWN = 3  # problems named in an error; verify lists all
FINISH_IT = (
    "What its journal names is unchanged, the rest unconfirmed: ronna-procedure resume RUN completes it, "
    "ronna-procedure report RUN its report."
)


@dataclass(frozen=True)
class Problem:
    """A file that differs from the state in which the run left it, and the difference.

    `unfinished`: only because the run did not reach its end, or a report file is to be made anew. `beside`:
    nothing written by the run is affected (its folder was renamed, or a file added). `out_of_reach`: an input
    outside the run whose folder is missing or closed to us.
    """

    file: str
    what: str
    unfinished: bool = False
    beside: bool = False
    out_of_reach: bool = False

    @property
    def of_account(self) -> bool:
        """Whether journal, request or records are not as written."""
        of_it = self.file in (JOURNAL_FILE, REQUEST_FILE) or self.file.startswith(f"{RECORDS_FOLDER}/")
        return of_it and not self.beside

    def __str__(self) -> str:
        return f"{printable(self.file)}: {self.what}"


class KnownRecord(NamedTuple):
    """Hash and CT series of a record named by an earlier line of the journal."""

    sha256: str
    series: str | None


@dataclass(frozen=True)
class Inspection:
    """The journal of a run, those of its records that match the journal, and all problems."""

    folder: Path
    chain: Chain
    manifest: Manifest
    records: tuple[Record, ...]
    problems: tuple[Problem, ...]
    out_of_reach: tuple[str, ...] = ()  # inputs outside the run that are not here, and were not compared

    @property
    def superseded(self) -> frozenset[str]:
        """Identifiers of the superseded records."""
        return self.manifest.superseded

    @property
    def changes(self) -> tuple[Problem, ...]:
        """Problems other than those of a run that did not reach its end."""
        return tuple(problem for problem in self.problems if not problem.unfinished)

    @property
    def not_as_left(self) -> dict[str, str | None]:
        """Changed, missing and added files, with their hash at the last end or beginning; None without one.

        Excluded are files that every program continues, such as the log, unless added. A renamed folder is
        excluded too: every reading finds it.
        """
        known = self.manifest.files | self.manifest.outside | self.manifest.lasting
        return {
            one.file: known.get(one.file)
            for one in self.changes
            if one.file not in (JOURNAL_FILE, SEAL_FILE) and (one.beside or not is_later(one.file))
        }

    def require_unchanged(self, action: str | None = None) -> Inspection:
        """Return itself, or raise PRO-033 on any change; an unfinished run passes."""
        return self._require(self.changes, action)

    def require_account(self) -> Inspection:
        """Return itself, or raise PRO-033 if journal, request or records changed: homing depends on them."""
        return self._require(tuple(problem for problem in self.changes if problem.of_account))

    def require_whole(self) -> Inspection:
        """Return itself, or raise PRO-033 unless the folder is as a closed and sealed run left it."""
        return self._require(self.problems, None if self.changes else FINISH_IT)

    def require_content(self, name: str, content: bytes) -> bytes:
        """Return content read after the check; raise PRO-033 if its file was exchanged since."""
        named = self.manifest.files if self.chain.is_closed else {}
        changed = bool(named) and named.get(name) != hashlib.sha256(content).hexdigest()
        if what := "changed" if changed else self.manifest.truth_difference(name, content):
            self._require((Problem(name, what),))
        return content

    def _require(self, problems: tuple[Problem, ...], action: str | None = None) -> Inspection:
        if problems:
            state = "as it was left" if self.changes else "finished"
            more = f" and {len(problems) - SHOWN} more" if len(problems) > SHOWN else ""
            named = "; ".join(map(str, problems[:SHOWN]))
            raise RunChanged(f"{self.folder.name} is not {state}: {named}{more}", action=action)
        return self


def inspected(folder: Path, *, every_file: bool = True, files: Collection[str] = ()) -> Inspection:
    """Check a run folder; never raises because of its content.

    Without `every_file` only the journal (also against the seal), the records, and those of `files` that
    exist are checked, which takes milliseconds.
    """
    problems: list[Problem] = []
    chain = _chain(folder, problems)
    if count_names(chain.lines) > MOST_NAMES:
        problems.append(Problem(JOURNAL_FILE, f"names more than {MOST_NAMES} files: none was checked"))
        return Inspection(folder, chain, Manifest(), (), tuple(problems))
    manifest = Manifest(chain.lines)
    records = tuple(_records(folder, chain.lines, problems))
    if every_file and chain.lines:
        problems += _files(folder, chain, manifest)
    elif chain.lines:
        problems += _sealed_only(folder, chain, [name for name in files if os.path.lexists(folder / name)])
    found = tuple(one for one in dict.fromkeys(problems) if not one.out_of_reach)
    out_of_reach = dict.fromkeys(one.file for one in problems if one.out_of_reach)
    return Inspection(folder, chain, manifest, records, found, tuple(out_of_reach))


def _chain(folder: Path, problems: list[Problem]) -> Chain:
    try:
        chain, broken = chain_until_broken(folder / JOURNAL_FILE)
    except FileNotFoundError:
        began = any((folder / name).exists() for name in (RECORDS_FOLDER, SEAL_FILE))
        problems.append(Problem(JOURNAL_FILE, "missing", unfinished=not began))
        return Chain()
    except (OSError, InputRefused) as error:
        problems.append(Problem(JOURNAL_FILE, why_unread(error)))
        return Chain()
    if broken is not None:
        problems.append(Problem(JOURNAL_FILE, broken.what))
    if not chain.lines and (any((folder / RECORDS_FOLDER).glob("*.json")) or (folder / SEAL_FILE).exists()):
        problems.append(Problem(JOURNAL_FILE, "emptied: no line of it is left"))
    if chain.torn:
        what = f"torn: {len(chain.torn)} bytes after line {len(chain.lines)}"
        problems.append(Problem(JOURNAL_FILE, what, unfinished=True))
    if not chain.is_closed and broken is None:
        what = "not closed: the run was killed, is still running, or its last lines are missing"
        problems.append(Problem(JOURNAL_FILE, what, unfinished=True))
    run, name = chain.lines[0].get("run") if chain.lines else None, folder.resolve().name
    if run not in (None, name):
        what = f"of run {run}, in a folder named {name}"
        problems.append(Problem(JOURNAL_FILE, what, beside=True))
    return chain


def _records(folder: Path, lines: tuple[Line, ...], problems: list[Problem]) -> Iterator[Record]:
    """Records that match their lines and whose parents come before them."""
    known: dict[str, KnownRecord] = {}
    run = lines[0].get("run") if lines else None
    for line in lines:
        if line["entry"] != Entry.RESULT:
            continue
        name = f"{RECORDS_FOLDER}/{line.get('record')}.json"
        if refused := wrong_name(name) or ("named twice" if str(line.get("record")) in known else ""):
            problems.append(Problem(name, refused))
            continue
        try:
            record = read_record(folder / name)
        except BadRecord as problem:
            there = os.path.exists(folder / name)  # a name from a file may be too long to ask pathlib
            what = problem.what.removeprefix(f"{line.get('record')}.json ")
            problems.append(Problem(name, what if there else "missing: named in the journal"))
            series = None
        else:
            wrong = [Problem(name, what) for what in _mismatches(record, line, run, known)]
            problems += wrong
            if not wrong:
                yield record
            series = record.series
        known[str(line.get("record"))] = KnownRecord(str(line.get("sha256")), series)


def _mismatches(record: Record, line: Line, run: object, known: Mapping[str, KnownRecord]) -> Iterator[str]:
    step, _, trajectory = str(line.get("step")).partition(":")
    if record.sha256 != line.get("sha256"):
        yield "not the record named in the journal"
    if record.identifier != line.get("record"):
        yield f"identifies itself as {record.identifier}"
    if (record.kind, record.trajectory) != (step, trajectory or None):
        yield f"is of {record.kind} {record.trajectory or ''}, not of {line.get('step')}"
    if run is not None and record.run != run:
        yield f"is of run {record.run}"
    for identifier, sha256 in record.parents.items():
        parent = known.get(identifier)
        if parent is None or parent.sha256 != sha256:
            yield f"its parent {identifier} is not an earlier record of this run"
        elif parent.series is not None and parent.series != record.series:
            yield f"is of another CT series than its parent {identifier}"


def _files(folder: Path, chain: Chain, manifest: Manifest) -> Iterator[Problem]:
    """Problems with the request, pictures, truth, and every file named by the journal's end and the seal."""
    closed, named = chain.is_closed, manifest.files
    yield from compare_files(folder, manifest.request | manifest.pictures)
    yield from (Problem(name, what) for name, what in manifest.truth_problems(folder))
    there = [name for name, _ in files_of(folder)]
    seal = read_seal(folder)
    if closed:
        yield from compare_files(folder, named)
        yield from (Problem(name, what) for name, what in manifest.exchanged_inputs())
        # What could not be read at the end is compared with what results were made from.
        unread = {name: of for name, of in manifest.made_from.items() if name not in named}
        yield from compare_files(folder, unread | manifest.outside, inputs=True)
    else:
        yield from compare_files(folder, manifest.lasting)
        yield from _not_put_back(folder, manifest, there)
        # A resumed run compares what is in them.
        since = compare_files(folder, manifest.made_from, inputs=True)
        for one in since:
            yield replace(one, what=f"{one.what} since results were made from it", unfinished=True)
        for name in there:
            if name.startswith(f"{RECORDS_FOLDER}/") and name not in manifest.records:
                yield Problem(name, "not in the journal: written as the run was killed, or added", True)
    if seal is None:
        if os.path.lexists(folder / SEAL_FILE):
            yield Problem(SEAL_FILE, "changed")
        elif closed:
            yield Problem(SEAL_FILE, "missing: the run's end was not sealed", unfinished=True)
            unnamed = [name for name in there if name not in named and not is_later(name)]
            yield from _added(unnamed, sealed=False)
        return
    whole = yield from _against_seal(folder, chain, seal)
    if whole:
        yield from compare_files(folder, seal.files)
        yield from _added([name for name in there if name not in named and name not in seal.files])
    elif closed:
        yield Problem(SEAL_FILE, "from an earlier end: the last end was not sealed", unfinished=True)


def _not_put_back(folder: Path, manifest: Manifest, there: Collection[str]) -> Iterator[Problem]:
    """Report files that a killed program found changed or added, if they still are."""
    expected = manifest.not_vouched_for
    known = {name: sha256 for name, sha256 in expected.items() if sha256 is not None}
    yield from compare_files(folder, known, inputs=True)
    suspects = {*there} - {*TRUTH_FILES, *manifest.pictures}
    yield from _added([name for name in expected if expected[name] is None and name in suspects])


def _sealed_only(folder: Path, chain: Chain, names: Sequence[str]) -> Iterator[Problem]:
    """Problems with files that only the seal covers, and with the journal, which it also covers."""
    seal = read_seal(folder)
    if seal is None and os.path.lexists(folder / SEAL_FILE):
        yield Problem(SEAL_FILE, "changed")
    whole = seal is not None and (yield from _against_seal(folder, chain, seal))
    for name in names:
        if seal is None or not whole:
            yield Problem(name, "not confirmed by a seal")
        elif name in seal.files:
            yield from compare_files(folder, {name: seal.files[name]})
        else:
            yield from _added([name])


def _against_seal(folder: Path, chain: Chain, seal: Seal) -> Generator[Problem, None, bool]:
    """Differences between the journal and its sealed state; returns whether the seal covers all of it."""
    journal = read_json_lines(folder / JOURNAL_FILE, linked=False)
    sealed, after = journal[: seal.journal_bytes], journal[seal.journal_bytes :]
    if hashlib.sha256(sealed).hexdigest() != seal.journal_sha256:
        yield Problem(JOURNAL_FILE, "not the journal that was sealed: lines were changed, added or removed")
        return False
    went_on = chain.lines[sealed.count(b"\n") :]
    if went_on and went_on[0]["entry"] != Entry.RESTARTED:
        yield Problem(JOURNAL_FILE, "continues after its seal, but the run was not resumed")
    return not after


def _added(names: Sequence[str], *, sealed: bool = True) -> Iterator[Problem]:
    for name in names:
        if not sealed and name.endswith(PARTIAL):
            yield Problem(name, "incomplete: the program was killed while writing", unfinished=True)
        else:
            yield Problem(name, "added: not part of the run", beside=True)


def compare_files(folder: Path, hashes: Mapping[str, str], *, inputs: bool = False) -> Iterator[Problem]:
    """Compare files of the folder with their hashes; with `inputs` also files elsewhere, by whole path."""
    left_bytes = LARGEST_INPUTS_BYTES  # of those elsewhere, of which many names may lead to one
    for name, recorded in hashes.items():
        if wrong := wrong_name(name.removeprefix("/") if inputs else name):
            yield Problem(name, wrong)
            continue
        try:
            if PurePosixPath(name).is_absolute():
                left_bytes -= os.stat(name).st_size
            if left_bytes < 0:
                yield Problem(name, "not checked: too much lies outside the run", unfinished=True)
                continue
            if sha256_of(folder / name) != recorded:
                yield Problem(name, "changed")
        except (FileNotFoundError, ValueError):  # the second for a name that no file can have
            gone = _is_out_of_reach(name)
            yield Problem(name, "missing", unfinished=is_made_anew(name), out_of_reach=gone)
        except OSError as error:
            yield Problem(name, why_unread(error), out_of_reach=_is_out_of_reach(name))


def wrong_name(name: str) -> str:
    """Explain why a name is not that of a file in the folder: it leads elsewhere, or is not normalised."""
    path = PurePosixPath(name)
    leads_elsewhere = path.is_absolute() or ".." in path.parts
    return "not the name of a file of the run" if leads_elsewhere or path.as_posix() != name else ""


def why_unread(error: OSError | InputRefused) -> str:
    """Explain why a file of a run cannot be read."""
    if isinstance(error, InputRefused):
        return error.summary
    if error.errno in (errno.ELOOP, errno.EINVAL, errno.ENXIO, errno.EISDIR):
        return "replaced: not a regular file"
    if error.errno == errno.EFBIG:
        return "changed: larger than any file of a run"
    return f"cannot be read: {error.strerror}"


def _is_out_of_reach(name: str) -> bool:
    """Whether a file elsewhere is in a folder that is missing or may not be entered."""
    path = PurePosixPath(name)
    return path.is_absolute() and not os.access(path.parent, os.X_OK)
