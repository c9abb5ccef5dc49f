"""The files of a run, and one byte of one of them changed for a moment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def files_in(folder: Path) -> list[Path]:
    """Every file of a folder, in order."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


@contextmanager
def with_another_byte(path: Path, place: int, change: int) -> Iterator[None]:
    """Inside the block the byte at that place is another: `change`, 1 to 255, is what it is XORed with."""
    with path.open("r+b") as file:
        file.seek(place)
        (byte,) = file.read(1)
        file.seek(place)
        file.write(bytes([byte ^ change]))
    try:
        yield
    finally:
        with path.open("r+b") as file:
            file.seek(place)
            file.write(bytes([byte]))
