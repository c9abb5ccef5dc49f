"""Every command that the tutorial and the README show runs as written."""

from pathlib import Path

import pytest
from documented import commands_of, run_all
from user_commands import Commands


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_commands_of_the_tutorial_work_in_order(commands: Commands, tmp_path: Path) -> None:
    lines = commands_of("docs/tutorial/one-case.md")
    assert len(lines) >= 6
    run_all(lines, commands, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_check_after_the_operation_works_as_shown(commands: Commands, tmp_path: Path) -> None:
    lines = commands_of("docs/how-to/case/check-after-the-operation.md")
    assert len(lines) >= 4
    run_all(lines, commands, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_commands_of_the_readme_work(commands: Commands, tmp_path: Path) -> None:
    lines = commands_of("README.md")
    assert lines
    run_all(lines, commands, tmp_path)
