"""Calibration records that replace a theatre's own, as written by the calibration commands."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ronna_hw.bounded_input import read_toml
from sim.errors import BadCalibrationFile

CALIBRATION_FILE = "calibration.toml"


def read_calibrations(paths: Iterable[Path]) -> dict[str, Any]:
    """Records by their names in the theatre file; the later of two with the same name wins. Raises SIM-014.

    Their content is checked by readers of the theatre file.
    """
    records: dict[str, Any] = {}
    for path in paths:
        file = path / CALIBRATION_FILE if path.is_dir() else path
        try:
            found = read_toml(file, BadCalibrationFile).get("calibration")
        except OSError as error:
            raise BadCalibrationFile(f"cannot read {file}: {error.strerror}") from error
        if not isinstance(found, dict) or not found:
            raise BadCalibrationFile(f"{file} has no table [calibration] with records")
        records |= found
    return records
