"""The parent process, noted before anything heavy is imported.

An import may outlast the parent. If the parent dies in the meantime, `os.getppid` returns
init, which never ends.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

INIT = 1


@dataclass(frozen=True)
class ParentProcess:
    """The parent at the start of this process."""

    pid: int
    gone_at_start: bool = False

    @property
    def gone(self) -> bool:
        """Whether the parent has died, even before it could be noted."""
        return self.gone_at_start or os.getppid() != self.pid


def note_parent() -> ParentProcess:
    """Note the current parent.

    A service started by init leads its own process group or belongs to init's. A child of init in any other
    group is an orphan whose parent died before this call.
    """
    pid = os.getppid()
    orphan = pid == INIT and os.getpgrp() not in (os.getpid(), os.getpgid(INIT))
    return ParentProcess(pid, gone_at_start=orphan)


PARENT = note_parent()
