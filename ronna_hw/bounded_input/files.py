"""Files, read only up to their bound: the size reported by the file system may be wrong or missing."""

from __future__ import annotations

import errno
from pathlib import Path

from ronna_hw.bounded_input.refusal import InputRefused
from ronna_hw.host.regular_file import open_regular

GIVE_A_FILE = "Give a file: pipes, sockets and devices are not read."


def read_bounded(path: Path, limit_bytes: int, *, linked: bool = True) -> bytes:
    """A whole file. Raises INP-001 for more than `limit_bytes`, OSError.

    Never waits: a pipe, a socket or a device in its place is refused, without `linked` a link too (OSError).
    """
    try:
        with open_regular(path, linked=linked) as file:
            content = file.read(limit_bytes + 1)
    except OSError as error:
        if linked and error.errno in (errno.EINVAL, errno.ENXIO):  # the second of a socket
            raise InputRefused(f"{path} is not a regular file", action=GIVE_A_FILE) from error
        error.filename = error.filename or str(path)  # of what breaks while it is read nobody says the name
        raise
    if len(content) > limit_bytes:
        raise InputRefused(f"{path.name} is too large", limit=f"{limit_bytes} bytes")
    return content
