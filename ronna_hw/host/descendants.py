"""Every process below one of ours, for when that cannot end them itself any more.

A halted process takes notice of nothing but SIGKILL, neither of its parent's death.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import psutil


def descendants_of(number: int) -> list[psutil.Process]:
    """Of the process with this number; ask before it ends, afterwards they are nobody's."""
    import psutil  # not before it is needed: device processes import little

    try:
        below: list[psutil.Process] = psutil.Process(number).children(recursive=True)
    except psutil.Error:
        return []
    return below


def kill_all(processes: list[psutil.Process]) -> None:
    """End them hard; never raises, also for one that has ended."""
    import psutil

    for process in processes:
        with contextlib.suppress(psutil.Error):
            process.kill()
