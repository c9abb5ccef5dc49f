"""Opens a file safely if another user may have replaced it."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

NOT_REGULAR = (errno.EINVAL, "not a regular file")


def open_regular(path: Path, *, linked: bool = False) -> BinaryIO:
    """Open a file for reading. Raises OSError, also for a pipe or a device, and never blocks on one.

    Without `linked` also for a link.
    """
    follow = 0 if linked else os.O_NOFOLLOW
    try:
        file = os.open(path, os.O_RDONLY | follow | os.O_NONBLOCK | os.O_CLOEXEC)
    except ValueError as error:  # a zero byte, which no name of a file has
        raise OSError(errno.ENOENT, str(error), str(path)) from error
    mode = os.fstat(file).st_mode
    if not stat.S_ISREG(mode):
        os.close(file)
        number, reason = (errno.EISDIR, "is a directory") if stat.S_ISDIR(mode) else NOT_REGULAR
        raise OSError(number, reason, str(path))
    return os.fdopen(file, "rb")
