"""What the lines of a journal say about files and records: their names, and the hashes that they had."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import cast

from pydantic import BaseModel, ConfigDict, Field

from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, Entry, JournalValue, Line
from ronna_hw.host.files import open_regular, walk
from ronna_hw.records import PARTIAL, canonical_json, write_whole

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


TRUTH_FILES = ("theatre/scene.json", "theatre/truth.jsonl")  # small
GROWING = TRUTH_FILES[1:]
LARGEST_BYTES = 10_000_000  # ten times what the verifier reads
FIELD = "truth"  # of a line: name -> [bytes, SHA-256]


def truth_so_far(folder: Path) -> dict[str, JournalValue]:
    """The field of a line; empty for a run without a simulated theatre."""
    known: dict[str, JournalValue] = {}
    for name in TRUTH_FILES:
        with contextlib.suppress(OSError), open_regular(folder / name) as file:
            content = file.read(LARGEST_BYTES)
            known[name] = [len(content), hashlib.sha256(content).hexdigest()]
    return {FIELD: known} if known else {}


def unlike_truth(folder: Path, lines: Sequence[Line]) -> Iterator[tuple[str, str]]:
    """Files of a run that do not match its lines, and how."""
    for name in journalled_truth(lines):
        try:
            with open_regular(folder / name) as file:
                content = file.read(LARGEST_BYTES + 1)
        except FileNotFoundError:
            yield name, "missing"
        except OSError as error:
            yield name, f"replaced, or cannot be read: {error.strerror}"
        else:
            if what := unlike_content(name, content, lines):
                yield name, what


def unlike_content(name: str, content: bytes, lines: Sequence[Line]) -> str:
    """How the content of such a file does not match the lines; empty if it does, or they do not name it."""
    if name not in (known := journalled_truth(lines)):
        return ""
    size, sha256, number = known[name]
    if len(content) < size or hashlib.sha256(content[:size]).hexdigest() != sha256:
        return "changed"
    if len(content) > size and not (name in GROWING and _begun(lines[number + 1 :])):
        return "continues beyond the journal, and no step was running"
    return ""


def journalled_truth(lines: Sequence[Line]) -> dict[str, tuple[int, str, int]]:
    """Length and hash of each file according to the last line that states them, and that line's number."""
    known: dict[str, tuple[int, str, int]] = {}
    for number, line in enumerate(lines):
        field = line.get(FIELD)
        for name, value in field.items() if isinstance(field, Mapping) else ():
            match value:
                case [int(length), str(sha256)] if name in TRUTH_FILES and length >= 0:
                    known[name] = (int(length), sha256, number)
    return known


def _begun(lines: Sequence[Line]) -> bool:
    return any(line["entry"] in (Entry.INTENT, Entry.RESTARTED) for line in lines)


SEAL_FILE = "seal.json"
ROOM_FILE = f".room{PARTIAL}"  # held while a run is open; a kill leaves it as an unfinished file
REPORT_FILE = "report.html"
ONLY_IN_REPORT = "report/postoperative"  # the check after the operation: its CT is elsewhere
# Also written after the run is closed: prefixes of file names, and folders with everything in them.
LATER_FILES = (
    *("log.jsonl", "events.jsonl", REPORT_FILE, ROOM_FILE),
    *("theatre/world.json", "theatre/.world.json"),
)
RAW_FOLDER = "raw"  # images and frames as files, if wanted
LATER_FOLDERS = ("report", RAW_FOLDER)
BESIDE = f".report{PARTIAL}"  # where a new report is written
THEATRE_FILES = ("theatre/*.toml", "theatre/*.rom")
APART = (
    "export",
    BESIDE,
    f".{RAW_FOLDER}{PARTIAL}",
)  # folders derived from the run at any time, and not part of it
FIRST_FOLDERS = ("records", "pictures", "readings", "bytes", "theatre", "case", "case/ct")
OWN_FOLDERS = frozenset((*FIRST_FOLDERS, *LATER_FOLDERS, "raw/pictures"))  # made empty at first
CHUNK_BYTES = 1 << 20
LARGEST_FILE_BYTES = 4_000_000_000  # twice the tape of readings at its largest


class Seal(BaseModel):
    """The content of `seal.json`. `own_sha256` is the hash of everything else in it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = Field(default=2, alias="schema")
    journal_bytes: int = Field(description="Length of the journal that was sealed.")
    journal_sha256: str
    files: dict[str, str] = Field(description="Files not named in the journal, with their SHA-256.")
    own_sha256: str = ""

    @property
    def whole(self) -> bool:
        """Whether it is unchanged."""
        return self.own_sha256 == self._own()

    def with_own_hash(self) -> Seal:
        """The same with its own hash."""
        return self.model_copy(update={"own_sha256": self._own()})

    def _own(self) -> str:
        content = [self.schema_version, self.journal_bytes, self.journal_sha256, self.files]
        return hashlib.sha256(canonical_json(content)).hexdigest()


def sha256_of(path: Path) -> str:
    """Hash of a file's content. Raises OSError, also if it is not a regular file, or too large for a run."""
    found = hashlib.sha256()
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        # A log may grow meanwhile by some lines; what claims to be empty, as in /proc, may have no end.
        left = size + CHUNK_BYTES if size <= LARGEST_FILE_BYTES else 0
        while part := file.read(CHUNK_BYTES):
            left -= len(part)
            if left < 0:
                raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
            found.update(part)
    return found.hexdigest()


def files_of(folder: Path) -> Iterator[tuple[str, Path]]:
    """Every file of a run by its name there, without journal, seal and exports.

    Also folders that are deeper than any run goes or may not be read, below which nothing is listed, and
    empty ones that no run makes.
    """
    found = sorted(walk(folder, without=APART))
    parents = {one.path.parent for one in found}
    for path, is_folder, entered in found:
        name = path.relative_to(folder).as_posix()
        expected = is_folder and entered and (path in parents or name in OWN_FOLDERS)
        if not expected and name not in (JOURNAL_FILE, SEAL_FILE):
            yield name, path


def unchecked_folders(folder: Path) -> list[str]:
    """Names of folders in a run's folder that are not part of it, and that no check looks into."""
    return [name for name in APART if (folder / name).is_dir()]


def hashes_at_closing(folder: Path) -> dict[str, str]:
    """Hashes of the files that are complete when a run is closed. Raises OSError."""
    return {name: sha256_of(path) for name, path in _own_files(folder) if not is_later(name)}


def hashes_outside(folder: Path, inputs: Iterable[Path]) -> dict[str, str]:
    """Hashes of files and whole folders outside a run that it worked with, by path."""
    hashes = {}
    for given in inputs:
        if folder.resolve() in given.resolve().parents or not given.exists():
            continue
        paths = sorted(path for path, *_ in walk(given) if path.is_file()) if given.is_dir() else [given]
        hashes.update({str(path.resolve()): sha256_of(path.resolve()) for path in paths})
    return hashes


def input_hashes(folder: Path, files: Iterable[Path]) -> dict[str, str]:
    """Hashes of files that a run works with, as far as they can be read.

    By name in the run's folder, and by whole path elsewhere.
    """
    own, hashes = folder.resolve(), {}
    for path in (file.resolve() for file in files):
        name = path.relative_to(own).as_posix() if own in path.parents else str(path)
        with suppress(OSError):
            hashes[name] = sha256_of(path)
    return hashes


def theatre_files(folder: Path) -> list[Path]:
    """Files that describe the theatre in a run's folder: nothing changes them while the run is open."""
    return sorted(path for kind in THEATRE_FILES for path in folder.glob(kind))


def seal(folder: Path, closed: Collection[str], apart: Collection[str] = ()) -> None:
    """Write the seal over the files named neither by the journal's last line (`closed`) nor by `apart`.

    Raises OSError.
    """
    later = {
        name: sha256_of(path) for name, path in _own_files(folder) if name not in closed and name not in apart
    }
    journal = folder / JOURNAL_FILE
    made = Seal(
        journal_bytes=journal.stat().st_size, journal_sha256=sha256_of(journal), files=later
    ).with_own_hash()
    write_whole(folder / SEAL_FILE, _as_written(made))


def read_seal(folder: Path) -> Seal | None:
    """The seal of a run; None if there is none, or it is unreadable or was changed."""
    try:
        content = read_json_bytes(folder / SEAL_FILE, linked=False)
        found = Seal.model_validate_json(content)
    except (OSError, ValueError):
        return None
    return found if found.whole and content == _as_written(found) else None


def is_sealed(folder: Path) -> bool:
    """Whether the seal covers the journal at its present length."""
    found = read_seal(folder)
    return found is not None and found.journal_bytes == (folder / JOURNAL_FILE).stat().st_size


def is_later(name: str) -> bool:
    """Whether a file with that name is also written after the run is closed."""
    return name.split("/", 1)[0] in LATER_FOLDERS or name.startswith(LATER_FILES)


def is_made_anew(name: str) -> bool:
    """Whether it is a file of the report that follows from the rest of the run."""
    return name == REPORT_FILE or (name.startswith("report/") and not name.startswith(ONLY_IN_REPORT))


def _as_written(made: Seal) -> bytes:
    return made.model_dump_json(by_alias=True, indent=1).encode()


def _own_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """The files that a run can have written itself; any other is an added one, whenever it came."""
    for name, path in files_of(folder):
        status = path.lstat()
        regular = stat.S_ISREG(status.st_mode) and status.st_size <= LARGEST_FILE_BYTES
        if regular and _is_text(name):
            yield name, path


def _is_text(name: str) -> bool:
    """Whether a name is UTF-8: another one has no form in the JSON of the seal."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
