"""The commands that a page of the documentation shows, run as they stand there."""

from __future__ import annotations

import doctest
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from user_commands import Commands

from ronna_hw.host.child_process import command

ROOT = Path(__file__).resolve().parents[3]
NOTEBOOKS = ROOT / "examples" / "notebooks"
FILE = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHOWN = re.compile(r"```console\n(.*?)```", re.DOTALL)
EXERCISE = re.compile(r"```(console|python)\n(.*?)```", re.DOTALL)
LENIENT = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def commands_of(page: str) -> list[str]:
    """Every line after a prompt, in the page's order."""
    return [line for block in SHOWN.findall(read_page(page)) for line in _after_prompts(block)]


def read_page(page: str) -> str:
    """The text of a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def _after_prompts(block: str) -> list[str]:
    lines = block.splitlines()
    return [line.removeprefix("$ ").replace(".venv/bin/", "") for line in lines if line.startswith("$ ")]


def write_files(page: str, folder: Path) -> None:
    """The files that a page shows, into a folder."""
    for name, content in FILE.findall(read_page(page)):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")


def python_of(page: str) -> str:
    """All Python blocks of a page that are not files, as one program."""
    return "\n".join(block for language, block in EXERCISE.findall(read_page(page)) if language == "python")


def run_exercises(page: str, commands: Commands, folder: Path) -> int:
    """Commands and Python of a page in its order, one Python session for all; returns how many statements.

    What Python shows must be what the page shows, with `...` for what differs from day to day.
    """
    session: dict[str, Any] = {}
    statements = 0
    for number, (language, block) in enumerate(EXERCISE.findall(read_page(page)), start=1):
        if language == "console":
            run_all(_after_prompts(block), commands, folder)
            continue
        said: list[str] = []
        example = doctest.DocTestParser().get_doctest(block, session, f"{page}, block {number}", page, 0)
        runner = doctest.DocTestRunner(optionflags=LENIENT, verbose=False)
        failed = runner.run(example, out=said.append, clear_globs=False).failed
        session = example.globs
        assert not failed, "".join(said)
        statements += len(example.examples)
    return statements


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


def execute_notebook(name: str, out: Path) -> list[dict[str, Any]]:
    """Execute a notebook in a process of its own and return its cells."""
    line = command("studies.cli", "notebook", str(NOTEBOOKS / name), "--out", str(out))
    done = subprocess.run(line, capture_output=True, text=True, timeout=150.0, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.split() == [str(out / name)]  # nothing left behind, nothing deprecated
    cells: list[dict[str, Any]] = json.loads((out / name).read_text())["cells"]
    return cells


def final_sentence(cells: list[dict[str, Any]]) -> str:
    """The sentence with which a notebook ends, after its last figure."""
    figure, sentence = cells[-1]["outputs"]
    assert "image/png" in figure["data"]
    text = "".join(sentence["text"]).strip()
    assert text.endswith(".")
    return text
