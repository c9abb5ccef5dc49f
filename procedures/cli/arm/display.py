"""What `ronna-arm` prints: a calibration, a check."""

from __future__ import annotations

from pathlib import Path

from procedures.calibration.arm.check import ArmCheck
from procedures.calibration.arm.record import ArmResult
from procedures.cli.arm.files import check_payload, payload_of
from procedures.reporting.calibration import ArmCheckFigures, ArmFigures
from ronna_hw.command_line import console


def print_calibration(result: ArmResult, folder: Path) -> None:
    """The figures of a calibration, and where its files are."""
    figures = ArmFigures.model_validate(payload_of(result)).figures()
    console.print_table(
        f"calibration {result.arm.identifier}",
        ["", "value"],
        [[one.name, one.value] for one in figures],
    )
    console.tell(f"records in {folder}: put calibration.toml into the theatre file, or use --write")


def print_check(result: ArmCheck) -> None:
    """The verdict of a check."""
    figures = ArmCheckFigures.model_validate(check_payload(result)).figures()
    console.print_table(
        f"check of calibration {result.calibration}",
        ["", "value", ""],
        [[one.name, one.value, one.verdict] for one in figures],
    )
