"""Who started this process, noted before anything heavy is imported.

An import may last longer than the parent lives. Asked for afterwards, the parent of an orphan is init, and
that parent never dies.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

INIT = 1


@dataclass(frozen=True)
class Parent:
    """A parent process as it was when this process began."""

    pid: int
    gone_at_start: bool = False

    @property
    def gone(self) -> bool:
        """True when the parent has died, be it before it could be noted."""
        return self.gone_at_start or os.getppid() != self.pid


def note_parent() -> Parent:
    """The parent now.

    A service of init leads a process group of its own, or lives in init's. A child of init in anybody
    else's group was left behind by a parent that died before this line.
    """
    pid = os.getppid()
    orphan = pid == INIT and os.getpgrp() not in (os.getpid(), os.getpgid(INIT))
    return Parent(pid, gone_at_start=orphan)


PARENT = note_parent()
