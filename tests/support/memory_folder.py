"""A folder in memory, for tests that write thousands of files: a disk would cost more than what they test."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

MEMORY = Path("/dev/shm")


@contextlib.contextmanager
def memory_folder(otherwise: Path) -> Iterator[Path]:
    """A new one, removed at the end; `otherwise` where there is no file system in memory."""
    if not os.access(MEMORY, os.W_OK):
        yield otherwise
        return
    with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
        yield Path(folder)
