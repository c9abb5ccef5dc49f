"""A report as a test reads it."""

from __future__ import annotations

import re
from pathlib import Path


def report_text(path: Path) -> str:
    """The page without the headings that its cells repeat for a phone."""
    return re.sub(r' data-label="[^"]*"', "", path.read_text(encoding="utf-8"))
