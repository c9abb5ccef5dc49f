"""Integrity check of a run folder for changed, missing, added, replaced or foreign files.

Journal and seal describe the folder as the run left it. A killed run has neither its last line nor a seal. It
is checked as far as it goes; findings that only its end could confirm are `unfinished`, not changes.
"""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from ronna_hw.bounded_input import InputRefused, parse_json, read_json_lines
from ronna_hw.evidence.journal_reading import (
    JOURNAL_FILE,
    RUN_CHANGED,
    Entry,
    JournalChain,
    Line,
    read_chain_until_break,
)
from ronna_hw.evidence.lost_journal_end import describe_lost_end, find_lost_lines, read_events
from ronna_hw.evidence.manifest import (
    CHUNK_BYTES,
    LOG_FILES,
    RECORDS_FOLDER,
    REPORT_FILE,
    REQUEST_FILE,
    SEAL_FILE,
    TRUTH_FILES,
    Manifest,
    RunSeal,
    count_names,
    is_of_report,
    is_regenerated,
    is_written_later,
    iterate_files,
    read_seal,
    sha256_of,
)
from ronna_hw.host.files import open_regular
from ronna_hw.records import PARTIAL, BadRecord, Record, read_record
from ronna_hw.text import printable

MOST_NAMES = 100_000  # of files in a journal: a run and its CT have some thousands
LARGEST_INPUTS_BYTES = 8_000_000_000  # four times the largest CT that is read
MOST_LINES_BEFORE_NAME = 100  # of a log: its first line names the run
SHOWN = 3  # problems named in an error; verify lists all
BESIDE_ACTION = "Rename the folder back and move added files out of it, then repeat."
FINISH_IT = (
    "What its journal names is unchanged, the rest unconfirmed: ronna-procedure resume RUN completes it, "
    "ronna-procedure report RUN its report."
)


@dataclass(frozen=True)
class Problem:
    """Difference between a file and the state in which the run left it.

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
    def is_account_file(self) -> bool:
        """Whether the problem affects the journal, the request or a record."""
        of_it = self.file in (JOURNAL_FILE, REQUEST_FILE) or self.file.startswith(f"{RECORDS_FOLDER}/")
        return of_it and not self.beside

    def __str__(self) -> str:
        return f"{printable(self.file)}: {self.what}"


class KnownRecord(NamedTuple):
    """Hash and CT series of a record listed earlier in the journal."""

    sha256: str
    series: str | None


@dataclass(frozen=True)
class Inspection:
    """Inspection result: the run's journal, its matching records, and all problems."""

    folder: Path
    chain: JournalChain
    manifest: Manifest
    records: tuple[Record, ...]
    problems: tuple[Problem, ...]
    out_of_reach: tuple[str, ...] = ()  # inputs outside the run that are not here, and were not compared
    every_file: bool = True  # compared, not only journal, request and records
    lost: tuple[Line, ...] = ()  # at the end of the journal, as the event file has them

    @property
    def journal(self) -> tuple[Line, ...]:
        return self.chain.lines

    @property
    def opened(self) -> Line:
        """First journal line: theatre, banner, strategy, seed. Empty if missing."""
        return self.journal[0] if self.journal else {}

    @property
    def name(self) -> str:
        """Original name of the run; its folder may have been renamed."""
        return str(self.opened.get("run") or self.folder.resolve().name)

    def lines(self, entry: Entry) -> tuple[Line, ...]:
        """Return the journal lines of one kind."""
        return tuple(line for line in self.journal if line["entry"] == entry)

    @property
    def valid_records(self) -> tuple[Record, ...]:
        return tuple(record for record in self.records if record.identifier not in self.superseded)

    @property
    def superseded(self) -> frozenset[str]:
        """Identifiers of superseded records."""
        return self.manifest.superseded

    @property
    def changes(self) -> tuple[Problem, ...]:
        """Problems not explained by an unfinished run."""
        return tuple(problem for problem in self.problems if not problem.unfinished)

    @property
    def not_as_left(self) -> dict[str, str | None]:
        """Changed, missing and added files, mapped to their last known hash or None.

        Excluded are files that every program continues, such as the log, unless added. A renamed folder is
        excluded too: every reading finds it.
        """
        known = self.manifest.files | self.manifest.outside_files | self.manifest.lasting_files
        return {
            issue.file: known.get(issue.file)
            for issue in self.changes
            if issue.file not in (JOURNAL_FILE, SEAL_FILE)
            and (issue.beside or not is_written_later(issue.file))
        }

    def require_unchanged(self, action: str | None = None) -> Inspection:
        """Return the inspection, or raise PRO-033 on any change. An unfinished run passes."""
        return self._require(self.changes, action)

    def require_account(self) -> Inspection:
        """Return the inspection, or raise PRO-033 if the journal, the request or a record changed.

        Homing needs them.
        """
        return self._require(tuple(problem for problem in self.changes if problem.is_account_file))

    def require_whole(self) -> Inspection:
        """Return the inspection, or raise PRO-033 unless the run is closed, sealed and unchanged."""
        return self._require(self.problems, None if self.changes else FINISH_IT)

    def require_content(self, name: str, content: bytes) -> bytes:
        """Return content read after the check, or raise PRO-033 if the file has been replaced since."""
        named = self.manifest.files if self.chain.is_closed else {}
        changed = bool(named) and named.get(name) != hashlib.sha256(content).hexdigest()
        if what := "changed" if changed else self.manifest.describe_truth_difference(name, content):
            self._require((Problem(name, what),))
        return content

    def check_files(self, names: Collection[str]) -> tuple[Problem, ...]:
        """Compare these files as they are now with their last known hashes."""
        if not self.chain.lines:
            return ()
        return tuple(_check_named_files(self.folder, self.chain, self.manifest, names))

    def _require(self, problems: tuple[Problem, ...], action: str | None = None) -> Inspection:
        if problems:
            state = "as it was left" if self.changes else "finished"
            more = f" and {len(problems) - SHOWN} more" if len(problems) > SHOWN else ""
            named = "; ".join(map(str, problems[:SHOWN]))
            if action is None and all(problem.beside for problem in problems):
                checked = "What the run wrote" if self.every_file else "Its journal, request and records"
                action = f"{checked}: unchanged. {BESIDE_ACTION}"
            raise RUN_CHANGED(f"{self.folder.name} is not {state}: {named}{more}", action=action)
        return self


def inspect_run(folder: Path, *, every_file: bool = True, files: Collection[str] = ()) -> Inspection:
    """Check a run folder; never raises, whatever its contents.

    Without `every_file` only the journal (also against the seal), the request, the records and `files` are
    checked, which takes milliseconds.
    """
    problems: list[Problem] = []
    events = read_events(folder)
    chain = _read_chain(folder, problems)
    if lost := find_lost_lines(events, chain.lines):
        problems.append(Problem(JOURNAL_FILE, describe_lost_end(lost, len(chain.lines)), unfinished=True))
    if count_names(chain.lines) > MOST_NAMES:
        problems.append(Problem(JOURNAL_FILE, f"names more than {MOST_NAMES} files: none was checked"))
        return Inspection(folder, chain, Manifest(), (), tuple(problems), every_file=every_file)
    manifest = Manifest(chain.lines)
    records = tuple(_check_records(folder, chain.lines, problems))
    problems += compare_files(folder, manifest.request)
    if every_file and chain.lines:
        problems += _check_files(folder, chain, manifest)
    elif chain.lines:
        problems += _check_named_files(folder, chain, manifest, files)
    found = tuple(issue for issue in dict.fromkeys(problems) if not issue.out_of_reach)
    out_of_reach = dict.fromkeys(issue.file for issue in problems if issue.out_of_reach)
    return Inspection(folder, chain, manifest, records, found, tuple(out_of_reach), every_file, lost)


def _read_chain(folder: Path, problems: list[Problem]) -> JournalChain:
    try:
        chain, broken = read_chain_until_break(folder / JOURNAL_FILE)
    except FileNotFoundError:
        began = any((folder / name).exists() for name in (RECORDS_FOLDER, SEAL_FILE))
        problems.append(Problem(JOURNAL_FILE, "missing", unfinished=not began))
        return JournalChain()
    except (OSError, InputRefused) as error:
        problems.append(Problem(JOURNAL_FILE, explain_unreadable(error)))
        return JournalChain()
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
        what = f"of run {run}, in a folder named {name}; rename the folder to {run}"
        problems.append(Problem(JOURNAL_FILE, what, beside=True))
    return chain


def _check_records(folder: Path, lines: tuple[Line, ...], problems: list[Problem]) -> Iterator[Record]:
    """Yield the records that match their journal lines and follow their parents."""
    known: dict[str, KnownRecord] = {}
    run = lines[0].get("run") if lines else None
    for line in lines:
        if line["entry"] != Entry.RESULT:
            continue
        name = f"{RECORDS_FOLDER}/{line.get('record')}.json"
        if refused := explain_bad_name(name) or ("named twice" if str(line.get("record")) in known else ""):
            problems.append(Problem(name, refused))
            continue
        try:
            record = read_record(folder / name)
        except BadRecord as problem:
            present = os.path.exists(folder / name)  # a name from a file may be too long to ask pathlib
            what = problem.what.removeprefix(f"{line.get('record')}.json ")
            problems.append(Problem(name, what if present else "missing: named in the journal"))
            series = None
        else:
            wrong = [Problem(name, what) for what in _find_mismatches(record, line, run, known)]
            problems += wrong
            if not wrong:
                yield record
            series = record.series
        known[str(line.get("record"))] = KnownRecord(str(line.get("sha256")), series)


def _find_mismatches(
    record: Record, line: Line, run: object, known: Mapping[str, KnownRecord]
) -> Iterator[str]:
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
        if (parent := known.get(identifier)) is None or parent.sha256 != sha256:
            yield f"its parent {identifier} is not an earlier record of this run"
        elif parent.series is not None and parent.series != record.series:
            yield f"is of another CT series than its parent {identifier}"


def _check_files(folder: Path, chain: JournalChain, manifest: Manifest) -> Iterator[Problem]:
    """Find problems with pictures, truth, and files listed by the journal's end or the seal."""
    closed, named = chain.is_closed, manifest.files
    yield from compare_files(folder, manifest.pictures)
    yield from (Problem(name, what) for name, what in manifest.find_truth_problems(folder))
    yield from _find_foreign_logs(folder, chain)
    present = [name for name, _ in iterate_files(folder)]
    seal = read_seal(folder)
    reopened = () if seal is None or seal.journal_bytes != chain.size else seal.reopened
    if closed:
        yield from _excuse_resume(compare_files(folder, named), reopened)
        yield from (Problem(name, what) for name, what in manifest.find_exchanged_inputs())
        # What could not be read at the end is compared with what results were made from.
        unread = {name: of for name, of in manifest.result_inputs.items() if name not in named}
        yield from compare_files(folder, unread | manifest.outside_files, inputs=True)
    else:
        yield from compare_files(folder, manifest.lasting_files)
        yield from _find_unrestored_files(folder, manifest, present)
        # A resumed run compares what is in them.
        for issue in compare_files(folder, manifest.result_inputs, inputs=True):
            yield replace(issue, what=f"{issue.what} since results were made from it", unfinished=True)
        for name in present:
            if name.startswith(f"{RECORDS_FOLDER}/") and name not in manifest.records:
                yield Problem(name, "not in the journal: written as the run was killed, or added", True)
    if seal is None:
        if os.path.lexists(folder / SEAL_FILE):
            yield Problem(SEAL_FILE, "changed")
        elif closed:
            yield Problem(SEAL_FILE, "missing: the run's end was not sealed", unfinished=True)
            unnamed = [name for name in present if name not in named and not is_written_later(name)]
            yield from _report_added_files(unnamed, sealed=False)
        return
    whole = yield from _compare_with_seal(folder, chain, seal)
    if whole:
        yield from _excuse_resume(compare_files(folder, seal.files), reopened)
        added = [name for name in present if name not in named and name not in seal.files]
        if REPORT_FILE not in seal.files:
            what = "not sealed: a report was being made"
            yield from (Problem(name, what, unfinished=True) for name in added if is_of_report(name))
            added = [name for name in added if not is_of_report(name)]
        yield from _excuse_resume(_report_added_files(added, sealed=not reopened), reopened)
    elif closed:
        yield Problem(SEAL_FILE, "from an earlier end: the last end was not sealed", unfinished=True)


def _excuse_resume(problems: Iterable[Problem], reopened: tuple[str, ...]) -> Iterator[Problem]:
    """Mark changes that a resume makes before its first line in the journal as those of an unfinished run."""
    for problem in problems:
        excused = problem.file in reopened
        what = "not confirmed: a resume that changes it was killed before its first line in the journal"
        yield replace(problem, what=what, unfinished=True, beside=False) if excused else problem


def _find_foreign_logs(folder: Path, chain: JournalChain) -> Iterator[Problem]:
    """Report logs and events of another run; only a seal covers them, since the journal omits them."""
    run = chain.lines[0].get("run")
    for name in LOG_FILES:
        with suppress(OSError):
            named = _find_run_name(folder / name)
            if None not in (run, named) and named != run:
                yield Problem(name, f"belongs to another run: {printable(str(named))}")


def _find_run_name(log: Path) -> object:
    """Return the run first mentioned in a log or event file, or None if its beginning mentions none."""
    with open_regular(log) as file:
        beginning = file.read(CHUNK_BYTES)
    for line in beginning.splitlines()[:MOST_LINES_BEFORE_NAME]:
        with suppress(ValueError):
            match parse_json(line):
                case {"run": str(run)} | {"what": {"line": {"run": str(run)}}}:
                    return run
    return None


def _find_unrestored_files(folder: Path, manifest: Manifest, present: Collection[str]) -> Iterator[Problem]:
    """Report files that a killed program found changed or added, unless restored since."""
    expected = manifest.unvouched_files
    known = {name: sha256 for name, sha256 in expected.items() if sha256 is not None}
    yield from compare_files(folder, known, inputs=True)
    suspects = {*present} - {*TRUTH_FILES, *manifest.pictures}
    yield from _report_added_files([name for name in expected if expected[name] is None and name in suspects])


def _check_named_files(
    folder: Path, chain: JournalChain, manifest: Manifest, names: Collection[str]
) -> Iterator[Problem]:
    """Find problems with these files, by the journal's end or the seal, and with the sealed journal."""
    at_end = manifest.files if chain.is_closed else {}
    if (seal := read_seal(folder)) is None and os.path.lexists(folder / SEAL_FILE):
        yield Problem(SEAL_FILE, "changed")
    whole = seal is not None and (yield from _compare_with_seal(folder, chain, seal))
    for name in names:
        if name in at_end:
            yield from compare_files(folder, {name: at_end[name]})
        elif seal is not None and whole and name in seal.files:
            yield from compare_files(folder, {name: seal.files[name]})
        elif not os.path.lexists(folder / name):
            continue
        elif seal is None or not whole:
            yield Problem(name, "not confirmed by a seal")
        else:
            yield from _report_added_files([name])


def _compare_with_seal(folder: Path, chain: JournalChain, seal: RunSeal) -> Generator[Problem, None, bool]:
    """Compare the journal with its sealed state; returns whether the seal covers all of it."""
    journal = read_json_lines(folder / JOURNAL_FILE, follow_links=False)
    sealed, after = journal[: seal.journal_bytes], journal[seal.journal_bytes :]
    if hashlib.sha256(sealed).hexdigest() != seal.journal_sha256:
        yield Problem(JOURNAL_FILE, "not the journal that was sealed: lines were changed, added or removed")
        return False
    if (later_lines := chain.lines[sealed.count(b"\n") :]) and later_lines[0]["entry"] != Entry.RESTARTED:
        yield Problem(JOURNAL_FILE, "continues after its seal, but the run was not resumed")
    return not after


def _report_added_files(names: Sequence[str], *, sealed: bool = True) -> Iterator[Problem]:
    for name in names:
        if not sealed and name.endswith(PARTIAL):
            yield Problem(name, "incomplete: the program was killed while writing", unfinished=True)
        else:
            yield Problem(name, "added: not part of the run", beside=True)


def compare_files(folder: Path, hashes: Mapping[str, str], *, inputs: bool = False) -> Iterator[Problem]:
    """Compare files in the folder with their hashes; `inputs` adds outside files, by full path."""
    remaining_bytes = LARGEST_INPUTS_BYTES  # of those elsewhere, of which many names may lead to one
    for name, recorded in hashes.items():
        if wrong := explain_bad_name(name.removeprefix("/") if inputs else name):
            yield Problem(name, wrong)
            continue
        try:
            if name.startswith("/"):
                remaining_bytes -= os.stat(name).st_size
            if remaining_bytes < 0:
                yield Problem(name, "not checked: too much lies outside the run", unfinished=True)
                continue
            if sha256_of(folder / name) != recorded:
                yield Problem(name, "changed")
        except (FileNotFoundError, ValueError):  # the second for a name that no file can have
            is_unreachable = _is_out_of_reach(name)
            yield Problem(name, "missing", unfinished=is_regenerated(name), out_of_reach=is_unreachable)
        except OSError as error:
            yield Problem(name, explain_unreadable(error), out_of_reach=_is_out_of_reach(name))


def explain_bad_name(name: str) -> str:
    """Explain why a name is invalid for a run file: it leads outside, or is not normalised."""
    # By the string: a journal may name a hundred thousand files, and a path object costs ten times as much.
    is_bad = not {"", ".", ".."}.isdisjoint(name.split("/"))
    return "not the name of a file of the run" if is_bad else ""


def explain_unreadable(error: OSError | InputRefused) -> str:
    """Explain why a run file cannot be read."""
    if isinstance(error, InputRefused):
        return error.summary
    if error.errno in (errno.ELOOP, errno.EINVAL, errno.ENXIO, errno.EISDIR):
        return "replaced: not a regular file"
    if error.errno == errno.EFBIG:
        return "changed: larger than any file of a run"
    return f"cannot be read: {error.strerror}"


def _is_out_of_reach(name: str) -> bool:
    """Return whether an outside file is in a missing or inaccessible folder."""
    return name.startswith("/") and not os.access(PurePosixPath(name).parent, os.X_OK)
