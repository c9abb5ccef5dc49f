"""Files, read no further than their bound: a size that the file system tells may be untrue, or none."""

from __future__ import annotations

from pathlib import Path

from ronna_hw.bounded_input.refusal import InputRefused
from ronna_hw.host.regular_file import open_regular


def read_bounded(path: Path, limit_bytes: int, *, linked: bool = True) -> bytes:
    """A whole file. Raises INP-001 for more than `limit_bytes`, OSError.

    Without `linked` also for a link, a pipe or a device in its place.
    """
    with path.open("rb") if linked else open_regular(path) as file:
        content = file.read(limit_bytes + 1)
    if len(content) > limit_bytes:
        raise InputRefused(f"{path.name} is too large", limit=f"{limit_bytes} bytes")
    return content
