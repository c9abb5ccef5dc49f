"""By which code a study's results were made."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

PROGRAM = "ronna-hw"
PACKAGES = ("procedures", "ronna_hw", "sim", "studies")  # what results may depend on


@cache
def code() -> str:
    """The version of the program, and a hash of its sources: constants are in no study's settings."""
    root, digest = Path(__file__).parents[3], hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes())
    return f"{version(PROGRAM)}, {digest.hexdigest()[:16]}"
