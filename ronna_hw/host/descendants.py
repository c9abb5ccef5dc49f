"""Every descendant of one of our processes, for when that process can no longer end them itself.

A halted process reacts only to SIGKILL, not even to its parent's death.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import psutil


def descendants_of(number: int) -> list[psutil.Process]:
    """Descendants of the process with this number; ask before it ends, afterwards they are orphaned."""
    import psutil  # imported late: device processes import little

    try:
        below: list[psutil.Process] = psutil.Process(number).children(recursive=True)
    except psutil.Error:
        return []
    return below


def kill_all(processes: list[psutil.Process]) -> None:
    """Kill them; never raises, not even for one that has already ended."""
    import psutil

    for process in processes:
        with contextlib.suppress(psutil.Error):
            process.kill()
