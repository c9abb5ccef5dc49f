"""How many files and sockets this program may have open at once, checked before it opens the first."""

from __future__ import annotations

import resource

from ronna_hw.errors import RonnaError


class TooFewOpenFiles(RonnaError):
    """The system allows this program too few open files and sockets for its task."""

    code = "PRC-002"
    action = "Raise it with ulimit -n in this shell or LimitNOFILE of the service, and start again."


def require_open_files(needed: int) -> None:
    """Raise PRC-002 if that many may not be open; a soft limit is raised as far as necessary."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise TooFewOpenFiles("the limit of open files is too low", expected=f"{needed}", got=f"{hard}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
