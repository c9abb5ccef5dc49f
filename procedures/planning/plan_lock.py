"""A plan that a case runs on is held, so that nobody saves another one in its place meanwhile."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from procedures.planning.errors import PlanInUse


@contextmanager
def held_plan(path: Path) -> Iterator[None]:
    """Hold a plan file for a case, beside others that hold it too; free when the program ends, however."""
    file = _locked(path, fcntl.LOCK_SH)
    try:
        yield
    finally:
        os.close(file)


@contextmanager
def replaced_plan(path: Path) -> Iterator[None]:
    """Keep cases from beginning on a plan file while another is put in its place. Raises PLAN-026.

    A file that does not exist yet is nobody's.
    """
    try:
        file = _locked(path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PlanInUse(f"a case runs on {path.name}: it can only be looked at") from None
    except FileNotFoundError:
        yield
        return
    try:
        yield
    finally:
        os.close(file)


def plan_in_use(path: Path) -> bool:
    """Whether a case that is running holds this plan file."""
    try:
        file = _locked(path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # no plan, or none that could be saved: saving says so
        return False
    os.close(file)
    return False


def _locked(path: Path, kind: int) -> int:
    """The file that stands there once it is locked: one that was replaced meanwhile is nobody's."""
    while True:
        file = _opened(path)
        try:
            fcntl.flock(file, kind)
            if os.path.samestat(os.fstat(file), os.stat(path)):
                return file
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _opened(path: Path) -> int:
    """Writable where it may be: on a network file system only such a file can be locked exclusively."""
    try:
        return os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        raise
    except OSError:
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC)
