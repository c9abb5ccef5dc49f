"""Enough disk space for the run: suspend before the journal can no longer be written."""

from __future__ import annotations

import shutil
from pathlib import Path

LEAST_FREE_BYTES = 200_000_000  # pictures, log and records of a long case are below a tenth of that
MEGABYTE = 1_000_000


class DiskSpace:
    """Free space where the run is written."""

    name = "disk space"

    def __init__(self, folder: Path, least_bytes: int = LEAST_FREE_BYTES) -> None:
        self._folder = folder
        self._least_bytes = least_bytes

    def unmet(self) -> str | None:
        """What is left, when it is too little."""
        try:
            free = shutil.disk_usage(self._folder).free
        except OSError as error:
            return f"the run folder cannot be read ({error.strerror}): mount it again"
        if free >= self._least_bytes:
            return None
        return (
            f"{free // MEGABYTE} MB free where the run is written, {self._least_bytes // MEGABYTE} MB "
            "required: delete files there that are no longer needed"
        )
