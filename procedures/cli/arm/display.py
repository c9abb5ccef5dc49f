"""What `ronna-arm check` prints."""

from __future__ import annotations

from procedures.calibration.arm.check import ArmCheck
from procedures.cli.arm.files import check_payload
from procedures.reporting.calibration import ArmCheckFigures
from ronna_hw.command_line import terminal


def print_check(result: ArmCheck) -> None:
    """The verdict of a check."""
    figures = ArmCheckFigures.model_validate(check_payload(result)).figures()
    terminal.print_table(
        f"check of calibration {result.calibration}",
        ["", "value", ""],
        [[one.name, one.value, one.verdict] for one in figures],
    )
