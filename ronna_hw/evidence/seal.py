"""Integrity of a run's files: hashes in the journal's last line, and a seal over the rest.

The journal's chain covers its lines, its last line every file present when the run was closed. The seal
covers what is written later (the log's end, the theatre's final state, the report), and the journal as a
whole, so that removing the last line is detected.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.host.folder_walk import walk
from ronna_hw.host.regular_file import open_regular
from ronna_hw.records import PARTIAL, canonical_json, write_whole

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
