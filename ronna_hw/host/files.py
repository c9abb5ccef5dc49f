"""Safe handling of files and folders that other users may have tampered with, and file permissions.

A run folder contains a patient's CT, plan, journal and report, so others may not read what a command writes.
"""

from __future__ import annotations

import errno
import os
import resource
import shutil
import stat
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple

from ronna_hw.errors import ErrorCode, RonnaError

NOT_REGULAR = (errno.EINVAL, "not a regular file")


def open_regular(path: Path, *, follow_links: bool = False) -> BinaryIO:
    """Open a file for reading without blocking. Raises OSError, including for a pipe or device.

    A link raises OSError too, unless `follow_links`.
    """
    follow = 0 if follow_links else os.O_NOFOLLOW
    try:
        file = os.open(path, os.O_RDONLY | follow | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a zero byte, which no name of a file has
        raise OSError(errno.ENOENT, str(error), str(path)) from error
    mode = os.fstat(file).st_mode
    if not stat.S_ISREG(mode):
        os.close(file)
        number, reason = (errno.EISDIR, "is a directory") if stat.S_ISDIR(mode) else NOT_REGULAR
        raise OSError(number, reason, str(path))
    return os.fdopen(file, "rb")


def sync_folder(folder: Path) -> None:
    """Flush the entries of a folder: a new name is on disk only when its folder is. Raises OSError."""
    directory = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


DEEPEST_LEVEL = 16  # of folders; a run has three


class WalkedPath(NamedTuple):
    """Path below a walked folder."""

    path: Path
    is_folder: bool  # not a link to one
    entered: bool  # a folder whose content follows


def walk(folder: Path, *, excluded: Collection[str] = ()) -> Iterator[WalkedPath]:
    """List everything below a folder without recursion, except top-level folders in `excluded`.

    Links are not followed. Folders at `DEEPEST_LEVEL` and unreadable ones are listed but not entered.
    """
    waiting = [(folder, 0)]
    while waiting:
        current_folder, level = waiting.pop()
        entries: list[os.DirEntry[str]] = []
        with suppress(OSError), os.scandir(current_folder) as listed:
            entries = sorted(listed, key=lambda entry: entry.name)
        for entry in entries:
            path, is_folder = current_folder / entry.name, entry.is_dir(follow_symlinks=False)
            if is_folder and level == 0 and entry.name in excluded:
                continue
            readable = is_folder and os.access(path, os.R_OK | os.X_OK)
            entered = readable and level + 1 < DEEPEST_LEVEL
            yield WalkedPath(path, is_folder, entered)
            if entered:
                waiting.append((path, level + 1))


def remove_folder(folder: Path) -> bool:
    """Remove a folder and its contents; returns whether it succeeded."""
    with suppress(OSError, RecursionError):  # the second for a chain of folders without end
        shutil.rmtree(folder)
    return not folder.exists()


ACCESS_VARIABLE = "RONNA_ACCESS"
_UMASKS = {"owner": 0o077, "group": 0o007}  # folders 0700 and files 0600, or 0770 and 0660


@contextmanager
def restrict_new_files() -> Iterator[None]:
    """Make files created in the block, including by child processes, private regardless of the umask.

    `RONNA_ACCESS=group` also admits the folder's group, for a folder that a lab shares. Raises ValueError for
    any other word.
    """
    access = os.environ.get(ACCESS_VARIABLE, "owner")
    if access not in _UMASKS:
        raise ValueError(f"{ACCESS_VARIABLE} is {access!r}; expected owner or group")
    before = os.umask(_UMASKS[access])
    try:
        yield
    finally:
        os.umask(before)


TOO_FEW_OPEN_FILES = ErrorCode(
    "PRC-002",
    RonnaError,
    "The system's limit on open files and sockets is too low for this task.",
    "Raise it with ulimit -n in this shell or LimitNOFILE of the service, and start again.",
)


def require_open_files(needed: int) -> None:
    """Raise the soft limit so that `needed` files can be open at once, or raise PRC-002."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise TOO_FEW_OPEN_FILES("the limit of open files is too low", expected=f"{needed}", got=f"{hard}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
