"""Options that do not belong to the theatre chosen, and what to do instead."""

from __future__ import annotations

from pathlib import Path

from coded_errors import raises

from procedures.cli.case.options import CaseOptions
from ronna_hw.command_line.errors import UsageMistake


def test_drill_with_a_theatre_file_names_the_line_to_write_there() -> None:
    with raises(UsageMistake, match=r"write assistant_drills = true under \[procedure\] of lab\.toml"):
        CaseOptions(config=Path("lab.toml"), drill=True).check()
