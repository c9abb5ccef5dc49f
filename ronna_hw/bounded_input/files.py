"""Files, read only up to their bound: the size reported by the file system may be wrong or missing."""

from __future__ import annotations

import errno
from pathlib import Path

from ronna_hw.bounded_input.refusal import InputRefused
from ronna_hw.host.regular_file import open_regular

GIVE_A_FILE = "Give a file: pipes, sockets and devices are not read."


def read_bounded(path: Path, limit_bytes: int, *, linked: bool = True) -> bytes:
    """A complete file. Raises INP-001 for more than `limit_bytes`, OSError.

    Never blocks: a pipe, socket or device in its place is refused, and without `linked`
    also a link (OSError).
    """
    try:
        with open_regular(path, linked=linked) as file:
            content = file.read(limit_bytes + 1)
    except OSError as error:
        if linked and error.errno in (errno.EINVAL, errno.ENXIO):  # the second for a socket
            raise InputRefused(f"{path} is not a regular file", action=GIVE_A_FILE) from error
        error.filename = error.filename or str(path)  # errors while reading do not name the file
        raise
    if len(content) > limit_bytes:
        raise InputRefused(f"{path.name} is too large", limit=f"{limit_bytes} bytes")
    return content
