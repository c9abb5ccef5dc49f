"""Two files written alternately: bounded disk use, with the latest part always available."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from ronna_hw.recording.byte_lines import FILE_NAMES


class AlternatingFiles:
    """The files of one link. When one is full the other is emptied and written."""

    def __init__(self, folder: Path, link: str, limit_bytes: int) -> None:
        """Continues what an earlier process of the same run has left. Raises OSError."""
        self._paths = [folder / name.format(link=link) for name in FILE_NAMES]
        self._limit_bytes = limit_bytes
        newest = max(self._paths, key=lambda path: path.stat().st_mtime_ns if path.exists() else 0)
        self._which = self._paths.index(newest)
        self._file = self._open(os.O_APPEND)
        self._size = os.fstat(self._file).st_size
        if self._size:
            try:
                self.write(b"\n")  # terminates a torn line
            except OSError:
                self.close()
                raise

    def write(self, lines: bytes) -> None:
        """Append complete lines. Raises OSError."""
        if self._size and self._size + len(lines) > self._limit_bytes:
            os.close(self._file)
            self._which = 1 - self._which
            self._file = self._open(os.O_TRUNC)
            self._size = 0
        written = os.write(self._file, lines)
        self._size += written
        if written != len(lines):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def _open(self, how: int) -> int:
        return os.open(self._paths[self._which], os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | how, 0o666)
