"""How many files and sockets this program may have open at once, known before it opens the first."""

from __future__ import annotations

import resource

from ronna_hw.errors import RonnaError


class TooFewOpenFiles(RonnaError):
    """The system lets this program have too few files and sockets open for what it is asked to do."""

    code = "PRC-002"
    action = "Raise it with ulimit -n in this shell or LimitNOFILE of the service, and start again."


def require_open_files(needed: int) -> None:
    """Raise PRC-002 where not so many may be open; a soft limit is raised as far as that takes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise TooFewOpenFiles("the limit of open files is too low", expected=f"{needed}", got=f"{hard}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
