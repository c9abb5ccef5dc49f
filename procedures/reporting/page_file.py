"""Page of HTML written from Python: only as a page, and outside of every run."""

from __future__ import annotations

import os
from pathlib import Path

from ronna_hw.arguments import WrongArgument, require_path, show
from ronna_hw.command_line.options import require_folder_of
from ronna_hw.records import write_atomically

PAGE_SUFFIX = ".html"


def write_page(out: str | os.PathLike[str], html: str) -> Path:
    """Write a page and return its path. Raises ARG-001 for another type, CLI-005 in a run, OSError."""
    path = require_path(out, "the file for a page")
    if path.suffix.lower() != PAGE_SUFFIX:
        raise WrongArgument(
            "the file for a page is no page",
            expected=f"a name that ends in {PAGE_SUFFIX}",
            got=show(str(out)),
            action=f"Write {path.with_suffix(PAGE_SUFFIX).name}, which a browser shows and prints.",
        )
    require_folder_of(path)
    write_atomically(path, html.encode())
    return path
