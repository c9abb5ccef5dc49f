"""Pictures of a run as they stand in its page: within the page itself."""

from __future__ import annotations

import base64
from pathlib import Path

from procedures.reporting.run_reading import RunReading
from ronna_hw.bounded_input import InputRefused, read_bounded

LARGEST_PICTURE_BYTES = 20_000_000  # ten times a case's largest


def picture_of(reading: RunReading, path: Path) -> bytes | None:
    """A picture's file; None, and with a note, for one that is too large or cannot be read."""
    try:
        return read_bounded(path, LARGEST_PICTURE_BYTES, linked=False)
    except (OSError, InputRefused):
        reading.note(f"{path.name} is left out: it cannot be read or is too large for a picture")
        return None


def embedded(picture: bytes) -> str:
    """A PNG as the address of an image."""
    return "data:image/png;base64," + base64.b64encode(picture).decode()
