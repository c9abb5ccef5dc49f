"""Processes started with a mark in their environment, which all that they start inherits."""

from __future__ import annotations

import os
import uuid
from pathlib import Path

MARK = "RONNA_TEST_MARK"


def marked_environment() -> tuple[str, dict[str, str]]:
    """A new mark, and this process's environment with it; NiceGUI must not see a test."""
    mark = uuid.uuid4().hex
    environment = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    return mark, environment | {MARK: mark}


def list_marked(mark: str) -> list[str]:
    """Command lines of the running processes with that mark, whatever became of their parents."""
    wanted = f"{MARK}={mark}".encode()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if wanted in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:  # it has ended, or is another user's
            continue
    return found
