"""What `ronna-arm check` prints."""

from __future__ import annotations

from procedures.reporting.calibration.arm import ArmCheckFigures
from ronna_hw.command_line import terminal


def print_check(figures: ArmCheckFigures) -> None:
    """The verdict of a check."""
    terminal.print_table(
        f"check of calibration {figures.calibration}",
        ["", "value", ""],
        [[one.name, one.value, one.verdict] for one in figures.table()],
    )
