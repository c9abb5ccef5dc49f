"""Walks a folder into which another user may have put anything: without recursion, to a bounded depth."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

DEEPEST_LEVEL = 16  # of folders; a run has three


class Found(NamedTuple):
    """A path below the folder that is walked."""

    path: Path
    is_folder: bool  # not a link to one
    entered: bool  # a folder whose content follows


def walk(folder: Path, *, without: Collection[str] = ()) -> Iterator[Found]:
    """Everything below a folder, except the folders directly in it that are named in `without`.

    Links are not followed; folders at `DEEPEST_LEVEL`, and those that may not be read, are listed and not
    entered.
    """
    waiting = [(folder, 0)]
    while waiting:
        at, level = waiting.pop()
        entries: list[os.DirEntry[str]] = []
        with suppress(OSError), os.scandir(at) as listed:
            entries = sorted(listed, key=lambda entry: entry.name)
        for entry in entries:
            path, is_folder = at / entry.name, entry.is_dir(follow_symlinks=False)
            if is_folder and level == 0 and entry.name in without:
                continue
            readable = is_folder and os.access(path, os.R_OK | os.X_OK)
            entered = readable and level + 1 < DEEPEST_LEVEL
            yield Found(path, is_folder, entered)
            if entered:
                waiting.append((path, level + 1))


def remove_folder(folder: Path) -> bool:
    """Remove a folder and everything in it; returns whether that succeeded."""
    with suppress(OSError, RecursionError):  # the second for a chain of folders without end
        shutil.rmtree(folder)
    return not folder.exists()
