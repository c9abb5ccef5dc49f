"""Every command that the tutorial and the README show is run as it stands there."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from user_commands import Commands

ROOT = Path(__file__).resolve().parents[2]
SHOWN = re.compile(r"```console\n(.*?)```", re.DOTALL)


def _commands_of(page: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    lines = [line for block in SHOWN.findall(text) for line in block.splitlines()]
    return [line.removeprefix("$ ").replace(".venv/bin/", "") for line in lines if line.startswith("$ ")]


def _run_all(lines: list[str], commands: Commands, folder: Path) -> None:
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
            timeout=100,
            check=False,
        )
        assert done.returncode == 0, f"{line}: {done.stderr}"


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_commands_of_the_tutorial_work_one_after_the_other(commands: Commands, tmp_path: Path) -> None:
    lines = _commands_of("docs/tutorial/one-case.md")
    assert len(lines) >= 6
    _run_all(lines, commands, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_command_of_the_readme_works(commands: Commands, tmp_path: Path) -> None:
    lines = _commands_of("README.md")
    assert lines
    _run_all(lines, commands, tmp_path)


@pytest.mark.parametrize(
    "command",
    [
        "ronna-procedure",
        "ronna-sim",
        "ronna-ct",
        "ronna-plan",
        "ronna-conformance",
        "ronna-rom",
        "ronna-stereo",
    ],
)
def test_every_command_of_the_readme_explains_itself_without_heavy_imports(
    commands: Commands, command: str
) -> None:
    program = commands.line(command, "--help")
    done = subprocess.run(
        [sys.executable, "-P", "-X", "importtime", *program], capture_output=True, text=True, check=True
    )
    assert "Usage:" in done.stdout
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "typer" in imported
    assert imported.isdisjoint({"scipy", "cv2", "pydicom", "matplotlib"})
