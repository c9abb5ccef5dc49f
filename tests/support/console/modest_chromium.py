"""The installed Chromium, started with no right to raise its priority and with software graphics."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
# As root Chromium raises its own priority, and with software graphics starves the robot's link.
NICE = ("nice", "-n", "15")
UNPRIVILEGED = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
SOFTWARE_GRAPHICS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
MISSING = None if CHROMIUM and shutil.which("setpriv") else "chromium is not installed (Debian: chromium)"


PATIENT_MS = 120_000  # a limit that only ends what has failed: it has the least of a busy computer


def opened_context(browser: Any, **more: Any) -> Any:
    """A browser's context whose pages wait as long."""
    context = browser.new_context(**more)
    context.set_default_timeout(PATIENT_MS)
    return context


@contextmanager
def modest_chromium(folder: Path) -> Iterator[Any]:
    """A browser for the length of the block; `folder` is for the script that starts it."""
    from playwright.sync_api import sync_playwright

    line = " ".join([*(UNPRIVILEGED if os.geteuid() == 0 else ()), *NICE])
    start = folder / "chromium"
    start.write_text(f'#!/bin/sh\nexec {line} {CHROMIUM} "$@"\n')
    start.chmod(0o755)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(start), args=list(SOFTWARE_GRAPHICS))
        try:
            yield browser
        finally:
            browser.close()
