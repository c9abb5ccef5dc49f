"""Every command that the tutorial, the README and the check after the operation show runs as written."""

from pathlib import Path

import pytest
from documented import commands_of, run_all
from user_commands import Commands


@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    ("page", "least"),
    [
        ("docs/tutorial/one-case.md", 6),
        ("docs/how-to/case/check-after-the-operation.md", 4),
        ("README.md", 1),
    ],
)
def test_the_commands_of_a_page_work_in_order(
    page: str, least: int, commands: Commands, tmp_path: Path
) -> None:
    lines = commands_of(page)
    assert len(lines) >= least
    run_all(lines, commands, tmp_path)
