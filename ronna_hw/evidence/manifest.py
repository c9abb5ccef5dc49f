"""The manifest of a run: the names of its files with their SHA-256, written and read only here.

It has two parts. The lines of the journal state what existed when they were written: the inputs that the run
began with and that its results were made from, pictures, the truth of a simulated theatre so far, and in the
last line every file of the closed run. The seal covers what is written later (the end of the log, the final
state of the theatre, the report), and the journal as a whole, so that removing its last line is detected.
"""

from __future__ import annotations

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
PICTURES_FOLDER = "pictures"  # of spheres in the CT and in the stereo head, for people
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
WITH_PORTS = "theatre/theatre.toml"  # written anew by each program that simulates the theatre
APART = (
    "export",
    BESIDE,
    f".{RAW_FOLDER}{PARTIAL}",
)  # folders derived from the run at any time, and not part of it
FIRST_FOLDERS = ("records", "pictures", "readings", "bytes", "theatre", "case", "case/ct")
OWN_FOLDERS = frozenset((*FIRST_FOLDERS, *LATER_FOLDERS, "raw/pictures"))  # made empty at first
LASTING = (REQUEST_FILE, f"{RECORDS_FOLDER}/", "case/")  # no longer changed once a run continues
TRUTH_FILES = ("theatre/scene.json", "theatre/truth.jsonl")  # constant, and growing while a step runs
GROWING = TRUTH_FILES[1:]
NOT_AS_LEFT = "not_as_left"  # in a `restarted` line: files that the end of the run does not vouch for
TRUTH_FIELD = "truth"  # of a line: name -> [bytes, SHA-256]
BEGINNINGS = (Entry.OPENED, Entry.RESTARTED)  # the first line of each program that has the run
CHUNK_BYTES = 1 << 20
LARGEST_FILE_BYTES = 4_000_000_000  # twice the tape of readings at its largest
LARGEST_TRUTH_BYTES = 10_000_000  # ten times what the verifier reads


def hashes_in(line: Line, field: str) -> dict[str, str]:
    """File names and hashes in a field of a line; empty without the field."""
    found = line.get(field)
    return cast("dict[str, str]", dict(found)) if isinstance(found, Mapping) else {}


def count_names(lines: Iterable[Line]) -> int:
    """Count the files that the lines of a journal name."""
    fields = ("pictures", "files", "inputs", NOT_AS_LEFT)
    return sum(len(hashes_in(line, field)) for line in lines for field in fields)


def is_closed(lines: Sequence[Line]) -> bool:
    """Whether a journal ends like that of a closed run."""
    return bool(lines) and lines[-1]["entry"] == Entry.CLOSED


def last_end(lines: Sequence[Line]) -> Line:
    """The last `closed` line; empty if the run was never closed."""
    return next((line for line in reversed(lines) if line["entry"] == Entry.CLOSED), {})


def closed_files(lines: Sequence[Line]) -> dict[str, str]:
    """Files and hashes of the last `closed` line."""
    return hashes_in(last_end(lines), "files")


def record_files(lines: Iterable[Line]) -> set[str]:
    """Files of the records that lines name."""
    return {f"{RECORDS_FOLDER}/{line.get('record')}.json" for line in lines}


def picture_files(lines: Iterable[Line]) -> dict[str, str]:
    """Pictures and their hashes; a picture named with different ones has no valid hash."""
    pictures: dict[str, str] = {}
    for line in lines:
        for picture, of in hashes_in(line, "pictures").items():
            name = f"{PICTURES_FOLDER}/{picture}"
            pictures[name] = of if pictures.get(name, of) == of else "two hashes"
    return pictures


def begun_with(lines: Sequence[Line]) -> dict[str, str]:
    """Input files that the last program to open the run began with, with their hashes then."""
    begun = [line for number, line in enumerate(lines) if line["entry"] in BEGINNINGS or not number]
    return hashes_in(begun[-1], "inputs") if begun else {}


def made_from(lines: Sequence[Line]) -> dict[str, str]:
    """Input files of the standing results, with their hashes then.

    A finding updates the hash of a file that was rewritten since with the same meaning.
    """
    gone, found = superseded_in(lines), dict[str, str]()
    for line in lines:
        if line["entry"] in (Entry.RESULT, Entry.FINDING) and str(line.get("record")) not in gone:
            found |= hashes_in(line, "inputs")
    return found


def lasting_files(lines: Sequence[Line]) -> dict[str, str]:
    """Files of an open run that must not have changed since the journal named them, with their hashes.

    Inputs of results are left out: resuming the run compares their content.
    """
    lasting = {name: sha256 for name, sha256 in closed_files(lines).items() if name.startswith(LASTING)}
    apart = {WITH_PORTS, *made_from(lines)}
    return {name: sha256 for name, sha256 in (lasting | begun_with(lines)).items() if name not in apart}


def exchanged_inputs(lines: Sequence[Line]) -> Iterator[tuple[str, str]]:
    """Inputs of a closed run that differ between its standing results and its end, and how."""
    at_end = closed_files(lines) | hashes_in(lines[-1], "inputs")
    for name, sha256 in (begun_with(lines) | made_from(lines)).items():
        if at_end.get(name, sha256) != sha256:
            yield name, "exchanged while the run was open: its results were made from another file"


def not_vouched_for(lines: Sequence[Line]) -> dict[str, str | None]:
    """Files that were not as left when the run was resumed after an end, as in `Inspection.not_as_left`.

    This covers every program since that end, up to the one that has just closed the run: a killed one vouches
    for nothing. The first of them states how a file was left.
    """
    expected: dict[str, str | None] = {}
    for line in reversed(lines[:-1] if is_closed(lines) else lines):
        if line["entry"] == Entry.CLOSED:
            break
        if line["entry"] == Entry.RESTARTED:
            expected |= cast("dict[str, str | None]", hashes_in(line, NOT_AS_LEFT))
    return expected


def keep_earlier_hashes(hashes: Mapping[str, str], expected: Mapping[str, str | None]) -> dict[str, str]:
    """Hashes for the end of a run; files that were not as left keep their earlier hash.

    A file that never had one is omitted: it counts as added until somebody removes it.
    """
    held = {name: sha256 for name, sha256 in hashes.items() if name not in expected}
    return held | {name: sha256 for name, sha256 in expected.items() if sha256 is not None}


def superseded_in(lines: Iterable[Line]) -> frozenset[str]:
    """Identifiers of the records that the lines of a journal supersede."""
    gone = (line.get("supersedes") for line in lines)
    return frozenset(str(name) for names in gone if isinstance(names, list) for name in names)


def sha256_of(path: Path) -> str:
    """Hash a file. Raises OSError, also for anything but a regular file and for one too large for a run."""
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
    """Every file of a run with its name, except journal, seal and exports.

    Lists also unexpected folders: deeper than any run goes or unreadable (below which nothing is listed), and
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
    """Folders in a run's folder that are not part of it, into which no check looks."""
    return [name for name in APART if (folder / name).is_dir()]


def is_later(name: str) -> bool:
    """Whether a file with this name is also written after the run is closed."""
    return name.split("/", 1)[0] in LATER_FOLDERS or name.startswith(LATER_FILES)


def is_made_anew(name: str) -> bool:
    """Whether a file belongs to the report and follows from the rest of the run."""
    return name == REPORT_FILE or (name.startswith("report/") and not name.startswith(ONLY_IN_REPORT))


def theatre_files(folder: Path) -> list[Path]:
    """Files that describe the theatre in a run's folder; constant while the run is open."""
    return sorted(path for kind in THEATRE_FILES for path in folder.glob(kind))


def hashes_at_closing(folder: Path) -> dict[str, str]:
    """Hash the files that are complete when a run is closed. Raises OSError."""
    return {name: sha256_of(path) for name, path in _own_files(folder) if not is_later(name)}


def hashes_outside(folder: Path, inputs: Iterable[Path]) -> dict[str, str]:
    """Hash files and whole folders outside a run that it worked with, by path."""
    hashes = {}
    for given in inputs:
        if folder.resolve() in given.resolve().parents or not given.exists():
            continue
        paths = sorted(path for path, *_ in walk(given) if path.is_file()) if given.is_dir() else [given]
        hashes.update({str(path.resolve()): sha256_of(path.resolve()) for path in paths})
    return hashes


def input_hashes(folder: Path, files: Iterable[Path]) -> dict[str, str]:
    """Hash the input files of a run as far as they are readable.

    Files in the run's folder are named relative to it, others by their whole path.
    """
    own, hashes = folder.resolve(), {}
    for path in (file.resolve() for file in files):
        name = path.relative_to(own).as_posix() if own in path.parents else str(path)
        with suppress(OSError):
            hashes[name] = sha256_of(path)
    return hashes


def truth_so_far(folder: Path) -> dict[str, JournalValue]:
    """Journal field with length and hash of the truth files so far; empty without a simulated theatre."""
    known: dict[str, JournalValue] = {}
    for name in TRUTH_FILES:
        with suppress(OSError), open_regular(folder / name) as file:
            content = file.read(LARGEST_TRUTH_BYTES)
            known[name] = [len(content), hashlib.sha256(content).hexdigest()]
    return {TRUTH_FIELD: known} if known else {}


def journalled_truth(lines: Sequence[Line]) -> dict[str, tuple[int, str, int]]:
    """Last stated length and hash of each truth file, with the number of the line that states them."""
    known: dict[str, tuple[int, str, int]] = {}
    for number, line in enumerate(lines):
        field = line.get(TRUTH_FIELD)
        for name, value in field.items() if isinstance(field, Mapping) else ():
            match value:
                case [int(length), str(sha256)] if name in TRUTH_FILES and length >= 0:
                    known[name] = (int(length), sha256, number)
    return known


def truth_problems(folder: Path, lines: Sequence[Line]) -> Iterator[tuple[str, str]]:
    """Truth files of a run that do not match its journal, and how."""
    for name in journalled_truth(lines):
        try:
            with open_regular(folder / name) as file:
                content = file.read(LARGEST_TRUTH_BYTES + 1)
        except FileNotFoundError:
            yield name, "missing"
        except OSError as error:
            yield name, f"replaced, or cannot be read: {error.strerror}"
        else:
            if what := truth_difference(name, content, lines):
                yield name, what


def truth_difference(name: str, content: bytes, lines: Sequence[Line]) -> str:
    """How the content of a truth file differs from the journal; empty if it matches or is not named."""
    if name not in (known := journalled_truth(lines)):
        return ""
    size, sha256, number = known[name]
    if len(content) < size or hashlib.sha256(content[:size]).hexdigest() != sha256:
        return "changed"
    if len(content) > size and not (name in GROWING and _step_begun(lines[number + 1 :])):
        return "continues beyond the journal, and no step was running"
    return ""


def _step_begun(lines: Sequence[Line]) -> bool:
    return any(line["entry"] in (Entry.INTENT, Entry.RESTARTED) for line in lines)


class Seal(BaseModel):
    """Content of `seal.json`. `own_sha256` is the hash of all other fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = Field(default=2, alias="schema")
    journal_bytes: int = Field(description="Length of the journal that was sealed.")
    journal_sha256: str
    files: dict[str, str] = Field(description="Files not named in the journal, with their SHA-256.")
    own_sha256: str = ""

    @property
    def whole(self) -> bool:
        """Whether the seal itself is unchanged."""
        return self.own_sha256 == self._own()

    def with_own_hash(self) -> Seal:
        """A copy that contains its own hash."""
        return self.model_copy(update={"own_sha256": self._own()})

    def _own(self) -> str:
        content = [self.schema_version, self.journal_bytes, self.journal_sha256, self.files]
        return hashlib.sha256(canonical_json(content)).hexdigest()


def seal(folder: Path, closed: Collection[str], apart: Collection[str] = ()) -> None:
    """Seal every file that is neither in `closed`, the last line of the journal, nor in `apart`.

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
    """Read the seal of a run; None if it is missing, unreadable or changed."""
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


def _own_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Files that the run itself can have written; anything else was added."""
    for name, path in files_of(folder):
        status = path.lstat()
        regular = stat.S_ISREG(status.st_mode) and status.st_size <= LARGEST_FILE_BYTES
        if regular and _is_text(name):
            yield name, path


def _is_text(name: str) -> bool:
    """Whether a name is UTF-8; others have no form in the JSON of the seal."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _as_written(made: Seal) -> bytes:
    return made.model_dump_json(by_alias=True, indent=1).encode()
