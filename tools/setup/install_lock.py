"""Install a locked list of packages with pip, showing how far it is.

Needs nothing but Python and pip: it runs before anything is installed. What pip prints is shown if it fails.
"""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import TextIO

PACKAGE = re.compile(r"^(?:Collecting|Processing) (?:\S*/)?([A-Za-z0-9_.]+?)(?:-\d|==|\s).*\(line (\d+)\)\)")
UNPACKING = "Installing collected packages: "
POLL_S = 1.0
QUARTERS = 4  # lines of a log without a terminal
LAST_LINES = 20  # of pip, after a failure


class Progress:
    """One line that is rewritten on a terminal; elsewhere a line for each quarter."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._is_terminal = stream, stream.isatty()
        self._shown = ""

    def show(self, phase: str, share: float, what: str) -> None:
        """Show the share of a phase that is done, and its present object."""
        if self._is_terminal:
            self._stream.write(f"\r\x1b[K  {phase} {share:4.0%}  {what}")
        elif (quarter := f"  {phase} {int(share * QUARTERS) / QUARTERS:.0%}") != self._shown:
            self._shown = quarter
            self._stream.write(f"{quarter}\n")
        self._stream.flush()

    def end(self) -> None:
        """Leave the line."""
        if self._is_terminal:
            self._stream.write("\r\x1b[K")
            self._stream.flush()


def follow(lines: Iterable[str], listed_lines: int, site: Path, progress: Progress) -> list[str]:
    """Show what pip does by what it prints; return all of it."""
    printed, unpacked = [], threading.Event()
    watcher: threading.Thread | None = None
    for line in lines:
        printed.append(line)
        if found := PACKAGE.match(line):
            progress.show("fetching", int(found[2]) / listed_lines, found[1])
        elif line.startswith(UNPACKING):
            wanted = line.count(",") + 1
            watcher = threading.Thread(target=_watch, args=(site, wanted, unpacked, progress))
            watcher.start()
    unpacked.set()
    if watcher is not None:
        watcher.join()
    return printed


def _watch(site: Path, wanted: int, done: threading.Event, progress: Progress) -> None:
    """Count the packages that appear, while pip prints nothing."""
    before = len(list(site.glob("*.dist-info")))
    while not done.wait(POLL_S):
        now = min(wanted, len(list(site.glob("*.dist-info"))) - before)
        progress.show("unpacking", now / wanted, f"{now} of {wanted} packages")


def main() -> int:
    """Install the list given as first argument, with further arguments for pip; return pip's exit code."""
    lock, *options = sys.argv[1:]
    listed_lines = len(Path(lock).read_text(encoding="utf-8").splitlines())
    command = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off"]
    command += [*options, "--require-hashes", "-r", lock]
    progress = Progress(sys.stdout)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as pip:
        assert pip.stdout is not None
        printed = follow(pip.stdout, listed_lines, Path(sysconfig.get_path("purelib")), progress)
    progress.end()
    if pip.returncode:
        sys.stderr.write("".join(printed[-LAST_LINES:]))
    return pip.returncode


if __name__ == "__main__":
    sys.exit(main())
