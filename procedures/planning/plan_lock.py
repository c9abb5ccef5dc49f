"""A plan that a case runs on is held, so that nobody saves another one in its place meanwhile."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def held_plan(path: Path) -> Iterator[None]:
    """Hold a plan file for a case, beside others that hold it too; free when the program ends, however."""
    file = _opened(path)
    try:
        fcntl.flock(file, fcntl.LOCK_SH)
        yield
    finally:
        os.close(file)


def plan_in_use(path: Path) -> bool:
    """Whether a case that is running holds this plan file."""
    try:
        file = _opened(path)
    except OSError:  # no plan, or none that could be saved: saving says so
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(file)
    return False


def _opened(path: Path) -> int:
    """Writable where it may be: on a network file system only such a file can be locked exclusively."""
    try:
        return os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC)
