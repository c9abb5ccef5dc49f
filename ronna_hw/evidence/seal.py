"""Integrity of a run's files: hashes in the journal's last line, and a seal over the rest.

The journal's chain covers its lines, its last line every file that was there when the run was closed. What is
written after that (the log's end, how the theatre was left, the report) the seal covers, and the journal as a
whole with it, so that a removed last line shows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.host.regular_file import open_regular
from ronna_hw.records import PARTIAL, canonical_json, write_whole

SEAL_FILE = "seal.json"
ROOM_FILE = f".room{PARTIAL}"  # held while a run is open, and half of nothing when it is left by a kill
# Written also after the run is closed: how the names of files begin, and folders with everything in them.
LATER_FILES = (
    *("log.jsonl", "events.jsonl", "report.html", ROOM_FILE),
    *("theatre/world.json", "theatre/.world.json"),
)
RAW_FOLDER = "raw"  # pictures and frames as files, where they are wanted
LATER_FOLDERS = ("report", RAW_FOLDER)
BESIDE = f".report{PARTIAL}"  # where a new report is written
APART = (
    "export/",
    f"{BESIDE}/",
    f".{RAW_FOLDER}{PARTIAL}/",
)  # made from the run at any time, and no part of it
CHUNK_BYTES = 1 << 20


class Seal(BaseModel):
    """The content of `seal.json`. `own_sha256` is of everything else in it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = Field(default=2, alias="schema")
    journal_bytes: int = Field(description="Length of the journal that was sealed.")
    journal_sha256: str
    files: dict[str, str] = Field(description="Files not named in the journal, with their SHA-256.")
    own_sha256: str = ""

    @property
    def whole(self) -> bool:
        """Whether it is as it was made."""
        return self.own_sha256 == self._own()

    def signed(self) -> Seal:
        """The same with its own hash."""
        return self.model_copy(update={"own_sha256": self._own()})

    def _own(self) -> str:
        content = [self.schema_version, self.journal_bytes, self.journal_sha256, self.files]
        return hashlib.sha256(canonical_json(content)).hexdigest()


def sha256_of(path: Path) -> str:
    """Of a file's content. Raises OSError, also for what is no regular file."""
    found = hashlib.sha256()
    with open_regular(path) as file:
        while part := file.read(CHUNK_BYTES):
            found.update(part)
    return found.hexdigest()


def files_of(folder: Path) -> Iterator[tuple[str, Path]]:
    """Every file of a run by its name in it, without journal, seal and exports."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if (path.is_symlink() or not path.is_dir()) and not _is_apart(name):
            yield name, path


def hashes_at_closing(folder: Path) -> dict[str, str]:
    """Hashes of the files that are complete when a run is closed. Raises OSError."""
    return {name: sha256_of(path) for name, path in files_of(folder) if not is_later(name)}


def hashes_outside(folder: Path, inputs: Iterable[Path]) -> dict[str, str]:
    """Hashes of files and whole folders that a run worked with and that are not in it, by their paths."""
    hashes = {}
    for given in inputs:
        if folder.resolve() in given.resolve().parents or not given.exists():
            continue
        paths = [path for path in sorted(given.rglob("*")) if path.is_file()] if given.is_dir() else [given]
        hashes.update({str(path.resolve()): sha256_of(path.resolve()) for path in paths})
    return hashes


def seal(folder: Path, closed: Collection[str], apart: Collection[str] = ()) -> None:
    """Write the seal over the files that neither the journal's last line (`closed`) nor `apart` names.

    Raises OSError.
    """
    later = {
        name: sha256_of(path) for name, path in files_of(folder) if name not in closed and name not in apart
    }
    journal = folder / JOURNAL_FILE
    made = Seal(journal_bytes=journal.stat().st_size, journal_sha256=sha256_of(journal), files=later).signed()
    write_whole(folder / SEAL_FILE, _as_written(made))


def read_seal(folder: Path) -> Seal | None:
    """The seal of a run; None where there is none, or it cannot be read or was changed."""
    try:
        content = read_json_bytes(folder / SEAL_FILE, linked=False)
        found = Seal.model_validate_json(content)
    except (OSError, ValueError):
        return None
    return found if found.whole and content == _as_written(found) else None


def is_sealed(folder: Path) -> bool:
    """Whether the seal is over the journal as long as it is now."""
    found = read_seal(folder)
    return found is not None and found.journal_bytes == (folder / JOURNAL_FILE).stat().st_size


def is_later(name: str) -> bool:
    """Whether a file of that name is written also after the run is closed."""
    return name.split("/", 1)[0] in LATER_FOLDERS or name.startswith(LATER_FILES)


def _as_written(made: Seal) -> bytes:
    return made.model_dump_json(by_alias=True, indent=1).encode()


def _is_apart(name: str) -> bool:
    return name in (JOURNAL_FILE, SEAL_FILE) or name.startswith(APART)
