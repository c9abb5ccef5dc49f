"""The guides for the first days with hardware, exercised from their text on simulators."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from documented import ROOT, commands_of, run_all, run_exercises, write_files
from user_commands import Commands

from ronna_hw.host.child_process import ChildProcess, command
from sim.world.running import variables_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture
def ur_cell(commands: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with `cell/theatre.toml` of a simulated theatre with a UR5e."""
    monkeypatch.chdir(tmp_path)
    arguments = ("--scene", "mini", "--arm", "ur5e", "--out", "cell")
    with ChildProcess("ronna-sim theatre", command("sim.cli", "theatre", *arguments)) as child:
        commands.environment |= variables_of(child.ready)
        yield tmp_path


@pytest.fixture
def cell(commands: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with `cell/lab.toml`, made as the page on theatre files says, on simulated devices."""
    monkeypatch.chdir(tmp_path)
    arguments = ("--scene", "mini", "--first-day", "--out", "cell")
    with ChildProcess("ronna-sim theatre", command("sim.cli", "theatre", *arguments)) as child:
        commands.environment |= variables_of(child.ready)
        monkeypatch.setenv("RONNA_CONTROL", commands.environment["RONNA_CONTROL"])
        run_all(commands_of("docs/how-to/devices/a-theatre-of-your-own.md"), commands, tmp_path)
        (tmp_path / "ronna_hw").symlink_to(ROOT / "ronna_hw")  # the pages are read in a clone
        yield tmp_path


@pytest.mark.parametrize(
    ("page", "statements"), [("first-hardware-day", 60), ("first-tracker-day", 18), ("first-camera-day", 19)]
)
def test_a_hardware_day_is_rehearsed_from_its_text(
    page: str, statements: int, cell: Path, commands: Commands
) -> None:
    write_files(f"docs/how-to/devices/{page}.md", cell)
    assert run_exercises(f"docs/how-to/devices/{page}.md", commands, cell) >= statements


def test_the_day_with_a_ur_is_rehearsed_from_its_text(ur_cell: Path, commands: Commands) -> None:
    page = "docs/how-to/devices/first-day-with-a-ur.md"
    write_files(page, ur_cell)
    assert run_exercises(page, commands, ur_cell) >= 40
