"""Manifest of a run: its file names and SHA-256 hashes. Only this module writes and reads it.

It has two parts. The lines of the journal state the files that existed when they were written: inputs of the
run and of its results, pictures, and the truth of a simulated theatre so far. The last line names every file
of the closed run. The seal covers later files: the end of the log, the final state of the theatre, the
report. It also covers the journal as a whole, so that removing its last line is detected.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, cast

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, Entry, JournalValue, Line
from ronna_hw.host.files import open_regular, walk
from ronna_hw.records import PARTIAL, canonical_json, write_atomically

REQUEST_FILE = "request.json"
RESULT_FILE = "result.json"  # of a calibration, check or measurement
RECORDS_FOLDER = "records"
PICTURES_FOLDER = "pictures"  # of spheres in the CT and in the stereo head, for people
SEAL_FILE = "seal.json"
ROOM_FILE = f".room{PARTIAL}"  # held while a run is open; a kill leaves it as an unfinished file
REPORT_FILE = "report.html"
KEPT_TRUTH = "report/truth.json"  # what the verifier of a simulated theatre found: how the run ended
ONLY_IN_REPORT = (KEPT_TRUTH, "report/postoperative")  # evidence; of the check, the CT is elsewhere
# Also written after the run is closed: prefixes of file names, and folders with everything in them.
LOG_FILES = ("log.jsonl", "events.jsonl")  # each names its run at its beginning
WORLD_FILE = "theatre/world.json"  # how a simulated theatre was left
LATER_FILES = (*LOG_FILES, REPORT_FILE, ROOM_FILE, WORLD_FILE, "theatre/.world.json")
RAW_FOLDER = "raw"  # images and frames as files, if wanted
LATER_FOLDERS = ("report", RAW_FOLDER)
BESIDE = f".report{PARTIAL}"  # where a new report is written
THEATRE_FILES = ("theatre/*.toml", "theatre/*.rom")
WITH_PORTS = "theatre/theatre.toml"  # written anew by each program that simulates the theatre
ROTATED_LOGS = tuple(f"{LOG_FILES[0]}.{number}" for number in (1, 2, 3))
# Files that a resume changes before its first line in the journal, besides partial ones.
CHANGED_BY_RESUMING = (*LOG_FILES, *ROTATED_LOGS, WORLD_FILE, WITH_PORTS)
# Folders derived from the run at any time, and not part of it.
APART = ("export", BESIDE, f".{RAW_FOLDER}{PARTIAL}")
LASER_LINE_FILE = "laser-line.json"  # written beside the baseline of a calibration by a later check
LATER_RECORDS = (LASER_LINE_FILE,)  # dated and named by themselves, and not part of the run either
KEPT_PLAN = "case/plan.toml"  # of a simulated case, written by the run itself
FIRST_FOLDERS = ("records", "pictures", "readings", "bytes", "theatre", "case", "case/ct")
OWN_FOLDERS = frozenset((*FIRST_FOLDERS, *LATER_FOLDERS, "raw/pictures"))  # made empty at first
LASTING = (REQUEST_FILE, f"{RECORDS_FOLDER}/", "case/")  # no longer changed once a run continues
SCENE_FILE = "theatre/scene.json"
TRUTH_FILES = (SCENE_FILE, "theatre/truth.jsonl")  # constant, and growing while a step runs
GROWING = TRUTH_FILES[1:]
NOT_AS_LEFT = "not_as_left"  # in a `restarted` line: files that the end of the run does not vouch for
TRUTH_FIELD = "truth"  # of a line: name -> [bytes, SHA-256]
BEGINNINGS = (Entry.OPENED, Entry.RESTARTED)  # the first line of each program that has the run
CHUNK_BYTES = 1 << 20
LARGEST_FILE_BYTES = 4_000_000_000  # twice the tape of readings at its largest
LARGEST_TRUTH_BYTES = 10_000_000  # ten times what the verifier reads


def read_hashes(line: Line, field: str) -> dict[str, str]:
    """Return the file names and hashes in a field of a journal line, or an empty dict without the field."""
    found = line.get(field)
    return cast("dict[str, str]", dict(found)) if isinstance(found, Mapping) else {}


def count_names(lines: Iterable[Line]) -> int:
    """Count the files listed in the journal."""
    fields = ("pictures", "files", "inputs", NOT_AS_LEFT)
    return sum(len(read_hashes(line, field)) for line in lines for field in fields)


class StatedTruth(NamedTuple):
    """Last recorded length and SHA-256 of a truth file, and whether a step has begun since."""

    length: int
    sha256: str
    step_begun: bool = False


class Manifest:
    """Files of a run by name, with the SHA-256 recorded in the journal.

    `files` and `outside_files` are those of the last `closed` line, in the run's folder and elsewhere.
    `initial_inputs` are the inputs at the last opening of the run. `result_inputs` are those of the standing
    results, or of a finding that one was rewritten since with the same meaning. `pictures` with different
    hashes have no valid one. `superseded` are identifiers of records.

    `unvouched_files` are files that were not as left when the run was resumed after an end, as in
    `Inspection.not_as_left`. They are collected over every program since that end, up to the one that has
    just closed the run. A killed program vouches for nothing. The first program states the earlier hash of a
    file.
    """

    def __init__(self, lines: Sequence[Line] = ()) -> None:
        self.request = {} if not lines else _hash_of(REQUEST_FILE, lines[0].get("request_sha256"))
        self.files: dict[str, str] = {}
        self.outside_files: dict[str, str] = {}
        self.initial_inputs: dict[str, str] = {}
        self.result_inputs: dict[str, str] = {}
        self.pictures: dict[str, str] = {}
        self.records: set[str] = set()
        self.unvouched_files: dict[str, str | None] = {}
        self.truth: dict[str, StatedTruth] = {}
        superseded_names = (line.get("supersedes") for line in lines)
        self.superseded = frozenset(
            str(item) for names in superseded_names if isinstance(names, list) for item in names
        )
        for number, line in enumerate(lines):
            if line["entry"] in BEGINNINGS or not number:
                self.initial_inputs = read_hashes(line, "inputs")
            match line["entry"]:
                case Entry.RESULT | Entry.FINDING if str(line.get("record")) not in self.superseded:
                    self.result_inputs |= read_hashes(line, "inputs")
                case Entry.RESTARTED:
                    found = cast("dict[str, str | None]", read_hashes(line, NOT_AS_LEFT))
                    self.unvouched_files = found | self.unvouched_files
                case Entry.CLOSED:
                    self.files, self.outside_files = read_hashes(line, "files"), read_hashes(line, "inputs")
                    if number < len(lines) - 1:
                        self.unvouched_files = {}
            for picture, sha256 in read_hashes(line, "pictures").items():
                name = f"{PICTURES_FOLDER}/{picture}"
                self.pictures[name] = sha256 if self.pictures.get(name, sha256) == sha256 else "two hashes"
            if "record" in line:
                self.records.add(f"{RECORDS_FOLDER}/{line['record']}.json")
            self._note_truth(line)

    def _note_truth(self, line: Line) -> None:
        if line["entry"] in (Entry.INTENT, Entry.RESTARTED):
            self.truth = {name: known._replace(step_begun=True) for name, known in self.truth.items()}
        field = line.get(TRUTH_FIELD)
        for name, value in field.items() if isinstance(field, Mapping) else ():
            match value:
                case [int(length), str(sha256)] if name in TRUTH_FILES and length >= 0:
                    self.truth[name] = StatedTruth(int(length), sha256)

    @property
    def lasting_files(self) -> dict[str, str]:
        """Files of an open run that must be unchanged since the journal listed them.

        Inputs of results are left out: resuming the run compares their content.
        """
        lasting_files = {name: sha256 for name, sha256 in self.files.items() if name.startswith(LASTING)}
        apart, known = {WITH_PORTS, *self.result_inputs}, lasting_files | self.initial_inputs
        return {name: sha256 for name, sha256 in known.items() if name not in apart}

    def find_exchanged_inputs(self) -> Iterator[tuple[str, str]]:
        """Find inputs of a closed run that changed between its standing results and its end."""
        at_end = self.files | self.outside_files
        for name, sha256 in (self.initial_inputs | self.result_inputs).items():
            if at_end.get(name, sha256) != sha256:
                yield name, "exchanged while the run was open: its results were made from another file"

    def find_truth_problems(self, folder: Path) -> Iterator[tuple[str, str]]:
        """Find truth files of a run that do not match its journal."""
        for name in self.truth:
            try:
                with open_regular(folder / name) as file:
                    content = file.read(LARGEST_TRUTH_BYTES + 1)
            except FileNotFoundError:
                yield name, "missing"
            except OSError as error:
                yield name, f"replaced, or cannot be read: {error.strerror}"
            else:
                if what := self.describe_truth_difference(name, content):
                    yield name, what

    def describe_truth_difference(self, name: str, content: bytes) -> str:
        """Describe how a truth file differs from the journal; empty if it matches or is not listed."""
        if name not in self.truth:
            return ""
        size, sha256, step_begun = self.truth[name]
        if len(content) < size or hashlib.sha256(content[:size]).hexdigest() != sha256:
            return "changed"
        if len(content) > size and not (name in GROWING and step_begun):
            return "continues beyond the journal, and no step was running"
        return ""


def _hash_of(name: str, sha256: JournalValue) -> dict[str, str]:
    return {name: sha256} if isinstance(sha256, str) else {}


def keep_earlier_hashes(hashes: Mapping[str, str], expected: Mapping[str, str | None]) -> dict[str, str]:
    """Return the hashes for the end of a run, keeping earlier ones of files that changed unexpectedly.

    A file that never had one is omitted: it counts as added until somebody removes it.
    """
    held = {name: sha256 for name, sha256 in hashes.items() if name not in expected}
    return held | {name: sha256 for name, sha256 in expected.items() if sha256 is not None}


def sha256_of(path: Path) -> str:
    """Hash a file. Raises OSError, including for a non-regular file or one too large for a run."""
    found = hashlib.sha256()
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        # A log may grow meanwhile by some lines; what claims to be empty, as in /proc, may have no end.
        remaining_bytes = size + CHUNK_BYTES if size <= LARGEST_FILE_BYTES else 0
        while part := file.read(CHUNK_BYTES):
            remaining_bytes -= len(part)
            if remaining_bytes < 0:
                raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
            found.update(part)
    return found.hexdigest()


def iterate_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield every file of a run with its name, except journal, seal, exports and records added later.

    Also lists unexpected folders: too deep or unreadable ones, below which nothing is listed, and empty ones
    that no run makes.
    """
    found = sorted(walk(folder, excluded=APART))
    parents = {item.path.parent for item in found}
    for path, is_folder, entered in found:
        name = path.relative_to(folder).as_posix()
        expected = is_folder and entered and (path in parents or name in OWN_FOLDERS)
        apart = name in LATER_RECORDS and not is_folder
        if not expected and not apart and name not in (JOURNAL_FILE, SEAL_FILE):
            yield name, path


def list_unchecked(folder: Path) -> list[str]:
    """List the folders and records in a run's folder that are not part of the run and not checked."""
    folders = [name for name in APART if (folder / name).is_dir()]
    return folders + [name for name in LATER_RECORDS if (folder / name).is_file()]


def is_written_later(name: str) -> bool:
    """Return whether a file with this name may be written after the run is closed."""
    return name.split("/", 1)[0] in LATER_FOLDERS or name.startswith(LATER_FILES)


def is_regenerated(name: str) -> bool:
    """Return whether a file belongs to the report and can be regenerated from the rest of the run."""
    return name == REPORT_FILE or (name.startswith("report/") and not name.startswith(ONLY_IN_REPORT))


def is_of_report(name: str) -> bool:
    """Return whether a file belongs to the report, including the postoperative check."""
    return name == REPORT_FILE or name.startswith("report/")


def list_theatre_files(folder: Path) -> list[Path]:
    """List the files in a run's folder that describe the theatre, constant while the run is open."""
    return sorted(path for kind in THEATRE_FILES for path in folder.glob(kind))


def hash_files_at_closing(folder: Path) -> dict[str, str]:
    """Hash the files that are complete when a run is closed. Raises OSError."""
    return {name: sha256_of(path) for name, path in _own_files(folder) if not is_written_later(name)}


def hash_outside_files(folder: Path, inputs: Iterable[Path]) -> dict[str, str]:
    """Hash the outside files and folders used by a run, keyed by path."""
    hashes = {}
    for given in inputs:
        if folder.resolve() in given.resolve().parents or not given.exists():
            continue
        paths = sorted(path for path, *_ in walk(given) if path.is_file()) if given.is_dir() else [given]
        hashes.update({str(path.resolve()): sha256_of(path.resolve()) for path in paths})
    return hashes


def hash_inputs(folder: Path, files: Iterable[Path]) -> dict[str, str]:
    """Hash the readable input files of a run.

    Files in the run's folder are named relative to it, others by their whole path.
    """
    own, hashes = folder.resolve(), {}
    for path in (file.resolve() for file in files):
        name = path.relative_to(own).as_posix() if own in path.parents else str(path)
        with suppress(OSError):
            hashes[name] = sha256_of(path)
    return hashes


def hash_truth_files(folder: Path) -> dict[str, JournalValue]:
    """Build the journal field with lengths and hashes of the truth files; a real theatre has none."""
    known: dict[str, JournalValue] = {}
    for name in TRUTH_FILES:
        with suppress(OSError), open_regular(folder / name) as file:
            content = file.read(LARGEST_TRUTH_BYTES)
            known[name] = [len(content), hashlib.sha256(content).hexdigest()]
    return {TRUTH_FIELD: known} if known else {}


class RunSeal(BaseModel):
    """Contents of `seal.json`. `own_sha256` is the hash of all other fields.

    Before a resume changes anything it names in `reopened` the files that it changes before its first line in
    the journal. If it is killed there, they are unconfirmed; all others must match.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = Field(default=2, alias="schema")
    journal_bytes: int = Field(description="Length of the journal that was sealed.")
    journal_sha256: str
    files: dict[str, str] = Field(description="Files not named in the journal, with their SHA-256.")
    reopened: tuple[str, ...] = Field(default=(), description="Files not confirmed since a resume began.")
    own_sha256: str = ""

    @property
    def whole(self) -> bool:
        """Whether the seal itself is unchanged."""
        return self.own_sha256 == self._own()

    def with_own_hash(self) -> RunSeal:
        """Return a copy that includes its own hash."""
        return self.model_copy(update={"own_sha256": self._own()})

    @model_serializer(mode="wrap")
    def _omit_absent_note(self, serialize: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Write the seal of a run that nobody resumes as before there was such a note."""
        written: dict[str, object] = serialize(self)
        return {name: value for name, value in written.items() if name != "reopened" or value}

    def _own(self) -> str:
        content = [self.schema_version, self.journal_bytes, self.journal_sha256, self.files]
        content += [list(self.reopened)] if self.reopened else []
        return hashlib.sha256(canonical_json(content)).hexdigest()


def seal(
    folder: Path,
    closed: Collection[str],
    apart: Collection[str] = (),
    kept: Mapping[str, str] | None = None,
    reopened: tuple[str, ...] = (),
) -> None:
    """Seal every file that is neither in `closed` (the journal's last line) nor in `apart`.

    Files in `kept` keep these hashes, and `reopened` stay unconfirmed. Raises OSError.
    """
    later = {
        name: sha256_of(path) for name, path in _own_files(folder) if name not in closed and name not in apart
    }
    journal = folder / JOURNAL_FILE
    new_seal = RunSeal(
        journal_bytes=journal.stat().st_size,
        journal_sha256=sha256_of(journal),
        files=later | dict(kept or {}),
        reopened=reopened,
    ).with_own_hash()
    write_atomically(folder / SEAL_FILE, _encode_seal(new_seal))


def seal_report(folder: Path, *, finished: bool = True) -> None:
    """Renew the report part of a seal; all other files keep the hashes from their sealing.

    Before a report is replaced it is not `finished`: the seal covers no part of it. Raises OSError.
    """
    former = read_seal(folder)
    assert former is not None, "only a seal can be renewed"
    files = {
        name: sha256
        for name, sha256 in former.files.items()
        if name == KEPT_TRUTH or not is_of_report(name)  # without it, a kill would hide a miss
    }
    if finished:
        files |= {name: sha256_of(path) for name, path in _own_files(folder) if is_of_report(name)}
    renewed = former.model_copy(update={"files": files}).with_own_hash()
    write_atomically(folder / SEAL_FILE, _encode_seal(renewed))


def reopen_seal(folder: Path, changed: Collection[str] = ()) -> None:
    """Note in a seal that a program resumes the run, before it changes anything else.

    Names found `changed` before it stay changed, whoever is killed. A run without a valid seal needs no note.
    Raises OSError.
    """
    former = find_valid_seal(folder)
    if former is None or former.reopened:
        return
    names = tuple(name for name in CHANGED_BY_RESUMING if name not in changed)
    noted = former.model_copy(update={"reopened": names}).with_own_hash()
    write_atomically(folder / SEAL_FILE, _encode_seal(noted))


def read_seal(folder: Path) -> RunSeal | None:
    """Read the seal of a run, or return None if it is missing, unreadable or changed."""
    try:
        content = read_json_bytes(folder / SEAL_FILE, follow_links=False)
        found = RunSeal.model_validate_json(content)
    except (OSError, ValueError):
        return None
    return found if found.whole and content == _encode_seal(found) else None


def find_valid_seal(folder: Path) -> RunSeal | None:
    """Return the seal if it covers the journal as it is, or None."""
    found = read_seal(folder)
    with suppress(OSError):
        if found is not None and sha256_of(folder / JOURNAL_FILE) == found.journal_sha256:
            return found
    return None


def is_sealed(folder: Path) -> bool:
    """Return whether the seal covers the journal at its current length."""
    found = read_seal(folder)
    return found is not None and found.journal_bytes == (folder / JOURNAL_FILE).stat().st_size


def _own_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield files possibly written by the run itself; any others were added."""
    for name, path in iterate_files(folder):
        status = path.lstat()
        regular = stat.S_ISREG(status.st_mode) and status.st_size <= LARGEST_FILE_BYTES
        if regular and _is_text(name):
            yield name, path


def _is_text(name: str) -> bool:
    """Return whether a name is valid UTF-8, as the JSON of the seal requires."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _encode_seal(new_seal: RunSeal) -> bytes:
    return new_seal.model_dump_json(by_alias=True, indent=1).encode()
