"""Files of a run, and those outside it that it was made from, compared with their recorded hashes."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ronna_hw.bounded_input import InputRefused
from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.evidence.named_files import RECORDS_FOLDER, REQUEST_FILE
from ronna_hw.evidence.seal import is_made_anew, sha256_of
from ronna_hw.text.printable import printable

LARGEST_INPUTS_BYTES = 8_000_000_000  # four times the largest CT that is read


@dataclass(frozen=True)
class Problem:
    """One file that is not as the run left it, and how.

    `unfinished` if the only problem is that the run did not reach its end, or that a file of its report is to
    be made anew; `beside` if nothing written by the run is affected: its folder was renamed, or a file added;
    `out_of_reach` if it is an input outside the run whose folder is not there or not open to us.
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


def against(folder: Path, hashes: Mapping[str, str], *, inputs: bool = False) -> Iterator[Problem]:
    """Problems with files of the folder; with `inputs` also with files elsewhere, by their whole path."""
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


def _is_out_of_reach(name: str) -> bool:
    """Whether it is a file elsewhere whose folder is not there, or may not be entered."""
    path = PurePosixPath(name)
    return path.is_absolute() and not os.access(path.parent, os.X_OK)


def wrong_name(name: str) -> str:
    """What is wrong with the name of a file in a folder: it leads elsewhere, or has two forms."""
    path = PurePosixPath(name)
    leads_elsewhere = path.is_absolute() or ".." in path.parts
    return "not the name of a file of the run" if leads_elsewhere or path.as_posix() != name else ""


def why_unread(error: OSError | InputRefused) -> str:
    """Why a file of a run cannot be read."""
    if isinstance(error, InputRefused):
        return error.summary
    if error.errno in (errno.ELOOP, errno.EINVAL, errno.ENXIO, errno.EISDIR):
        return "replaced: not a regular file"
    if error.errno == errno.EFBIG:
        return "changed: larger than any file of a run"
    return f"cannot be read: {error.strerror}"
