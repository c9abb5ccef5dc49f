"""Plan locks: a running case prevents overwriting, and a planner excludes other planners."""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from socket import gethostname

from procedures.planning.errors import PLAN_NOT_SAVED, PLAN_UNREADABLE, PlanInUse
from ronna_hw.bounded_input import LARGEST_TOML_BYTES

LONGEST_HOLDER = 300  # bytes: a process and the longest name of a host


@dataclass(frozen=True)
class LockedPlan:
    """Content of a plan file at the time a case locked it."""

    content: bytes

    @property
    def sha256(self) -> str:
        """SHA-256 of the file."""
        return hashlib.sha256(self.content).hexdigest()


@contextmanager
def lock_plan(path: Path) -> Iterator[LockedPlan]:
    """Lock a plan file for a case, shared with other cases, until the case or its process ends.

    Raises PLAN-001.
    """
    with ExitStack() as stack:
        try:
            file = _lock(path, fcntl.LOCK_SH)
            stack.callback(os.close, file)
            content = os.pread(file, LARGEST_TOML_BYTES + 1, 0)
        except OSError as error:
            raise PLAN_UNREADABLE(f"cannot read {path}: {error.strerror}") from error
        yield LockedPlan(content)


@contextmanager
def plan_replacement(path: Path) -> Iterator[None]:
    """Prevent cases from starting on a plan file while it is replaced. Raises PLAN-025, PLAN-026.

    A file that does not exist yet is held by no one.
    """
    try:
        file = _lock(path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PlanInUse(f"a case is running on {path.name}: it can only be viewed") from None
    except FileNotFoundError:
        yield
        return
    except OSError as error:
        raise PLAN_NOT_SAVED(f"{path.name} cannot be locked: {error.strerror}") from error
    try:
        yield
    finally:
        os.close(file)


def is_plan_in_use(path: Path) -> bool:
    """Return whether a running case has locked this plan file."""
    try:
        file = _lock(path, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # no plan, or one that cannot be saved: saving reports that
        return False
    os.close(file)
    return False


def find_planner(plan: Path) -> str | None:
    """Return the process of another planner that has this plan, or None if none has it."""
    try:
        file = os.open(_planner_file(plan), os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return os.pread(file, LONGEST_HOLDER, 0).decode(errors="replace") or "another process"
    except OSError:  # a file system without locks
        return None
    finally:
        os.close(file)
    return None


def _planner_file(plan: Path) -> Path:
    return plan.with_name(f".{plan.name}.planner")  # the plan itself is replaced when saved


class PlannerLock:
    """Exclusive lock for changing a plan, from the first successful `take` until `leave`."""

    def __init__(self, plan: Path) -> None:
        self._path = _planner_file(plan)
        self._file: int | None = None
        self._is_released = False

    def take(self) -> bool:
        """Acquire the lock. Return False if another planner has it, True where locking is unsupported."""
        if self._is_released:
            return False
        if self._file is None:
            try:
                os.close(os.open(self._path, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, 0o644))
            except OSError:
                return True
            try:
                self._file = _lock(self._path, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except (BlockingIOError, FileNotFoundError):  # held, or its holder is just leaving
                return False
            except OSError:  # a file system without locks
                return True
            with suppress(OSError):  # such as a full disk: nobody is named
                os.ftruncate(self._file, 0)
                os.pwrite(self._file, f"process {os.getpid()} on {gethostname()}".encode(), 0)
        return True

    def leave(self) -> None:
        """Release the lock permanently."""
        self._is_released = True
        if self._file is not None:
            with suppress(OSError):  # in a folder that is no longer writable; only the lock counts
                self._path.unlink()
            os.close(self._file)
        self._file = None


def _lock(path: Path, kind: int) -> int:
    """Open and lock the file at this path; repeat if the file was replaced meanwhile."""
    while True:
        file = _open(path) if kind & fcntl.LOCK_EX else os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            fcntl.flock(file, kind)
            if os.path.samestat(os.fstat(file), os.stat(path)):
                return file
        except BaseException:  # including interruptions: a lock lasts as long as its descriptor
            os.close(file)
            raise
        os.close(file)


def _open(path: Path) -> int:
    """Open a file for writing if possible, since exclusive locks on network file systems require it."""
    try:
        return os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        raise
    except OSError:
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC)
