"""A folder in memory, for tests that write thousands of files: a disk would cost more than what they test."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

MEMORY = Path("/dev/shm")
PREFIX = "of-a-test-"


def shared_memory() -> set[str]:
    """Names of what programs share there, without the folders of tests."""
    return {name for name in os.listdir(MEMORY) if not name.startswith(PREFIX)}


@contextlib.contextmanager
def memory_folder(otherwise: Path) -> Iterator[Path]:
    """A new one, removed at the end; `otherwise` where there is no file system in memory."""
    if not os.access(MEMORY, os.W_OK):
        yield otherwise
        return
    with tempfile.TemporaryDirectory(prefix=PREFIX, dir=MEMORY) as folder:
        yield Path(folder)
