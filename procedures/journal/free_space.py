"""Free space for a run. Light: checked before anything is imported or started."""

from __future__ import annotations

import shutil
from pathlib import Path

LEAST_FREE_BYTES = 200_000_000  # pictures, log and records of a long case are below a tenth of it
MEGABYTE = 1_000_000
NO_DISK = "no files can be written there"


def describe_shortage(folder: Path, least_bytes: int = LEAST_FREE_BYTES) -> str | None:
    """Describe a lack of free space where a run is written, or return None if there is enough."""
    try:
        total, _, free = shutil.disk_usage(folder)
    except FileNotFoundError:
        return f"the run folder {folder} is not there: move it back, or mount its disk again"
    except OSError as error:
        return f"the run folder {folder} cannot be read ({error.strerror}): mount it again"
    if not total:  # such as /proc
        return NO_DISK
    if free >= least_bytes:
        return None
    return (
        f"{free // MEGABYTE} MB free where the run is written, {least_bytes // MEGABYTE} MB required: "
        "delete files there that are no longer needed"
    )
