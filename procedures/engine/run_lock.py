"""One program at a time works on a run: its folder is locked, and free when the program ends, however."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from procedures.engine.errors import RunInUse


@contextmanager
def held_run(folder: Path) -> Iterator[None]:
    """Hold a run's folder for this program; raises PRO-030 while another one does."""
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunInUse(f"another program has {folder.name} open") from None
        yield
    finally:
        os.close(file)
