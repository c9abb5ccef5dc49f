"""The commands that a page of the documentation shows, run as they stand there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from user_commands import Commands

ROOT = Path(__file__).resolve().parents[2]
FILE = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHOWN = re.compile(r"```console\n(.*?)```", re.DOTALL)


def commands_of(page: str) -> list[str]:
    """Every line after a prompt, in the page's order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    lines = [line for block in SHOWN.findall(text) for line in block.splitlines()]
    return [line.removeprefix("$ ").replace(".venv/bin/", "") for line in lines if line.startswith("$ ")]


def write_files(page: str, folder: Path) -> None:
    """The files that a page shows, into a folder."""
    for name, content in FILE.findall((ROOT / page).read_text(encoding="utf-8")):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")


def run_all(
    lines: list[str], commands: Commands, folder: Path, limit_s: float = 100.0
) -> list[subprocess.CompletedProcess[str]]:
    """One after the other in that folder; each must end well, within the limit."""
    ended = []
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    for line in lines:
        done = subprocess.run(
            line,
            shell=True,
            cwd=folder,
            env={**commands.environment, "PATH": path},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=limit_s,
            check=False,
        )
        assert done.returncode == 0, f"{line}: {done.stderr}"
        ended.append(done)
    return ended
