"""One program at a time works on a run: it locks the folder until it ends, even if it is killed."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from procedures.engine.errors import RunInUse
from ronna_hw.host.port_users import PortUser, holder_of_lock


def holder_of_run(folder: Path) -> PortUser | None:
    """The program that holds a run, if it can be seen; locks nothing."""
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return holder_of_lock(file)
    finally:
        os.close(file)


@contextmanager
def held_run(folder: Path) -> Iterator[None]:
    """Hold a run's folder for this program; raises PRO-030 while another one does."""
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = holder_of_lock(file)
            by = "another program" if holder is None else str(holder)
            raise RunInUse(
                f"{by} has {folder.name} open",
                action=f"Operate it where it runs; to follow it from here: ronna-procedure watch {folder}",
            ) from None
        yield
    finally:
        os.close(file)
