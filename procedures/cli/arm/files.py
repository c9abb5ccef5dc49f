"""What a calibration of the arm leaves behind, beside records and figures: the looks.

OUT/<id>/looks.json          what was seen from where; calibrate again with --from
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from procedures.calibration.arm.check import ArmCheck
from procedures.calibration.arm.looks import LOOKS_FILE, ArmLooks
from procedures.calibration.arm.record import ArmResult
from procedures.calibration.observations import read_strict
from procedures.cli.calibrating.files import write_payload, write_records
from ronna_hw.records import write_whole


def read_looks(path: Path) -> ArmLooks:
    """Stored looks, from their file or folder. Raises CAL-005."""
    return read_strict(ArmLooks, path / LOOKS_FILE if path.is_dir() else path)


def write_looks(observed: ArmLooks, folder: Path) -> None:
    """Keep the looks before anything is computed from them."""
    write_whole(folder / LOOKS_FILE, observed.model_dump_json(by_alias=True, indent=1).encode())


def write_result(result: ArmResult, folder: Path) -> None:
    """Write records and figures."""
    write_records(records_of(result), folder)
    write_payload(payload_of(result), folder)


def records_of(result: ArmResult) -> dict[str, Any]:
    """The new records by the names that the theatre file has for them."""
    records = {"arm": result.arm, "stereo_head": result.stereo_head, "tool_tip": result.tool_tip}
    return {name: record.model_dump() for name, record in records.items() if record is not None}


def payload_of(result: ArmResult) -> dict[str, Any]:
    """The figures of a calibration as plain numbers."""
    fit, held = result.fit, result.validation
    return {
        "calibration": result.arm.identifier,
        "created": result.arm.created.isoformat(),
        "expires": result.arm.expires.isoformat(),
        "arm": result.arm.arm,
        "looks": len(fit.used),
        "outliers": int((~fit.used).sum()),
        "validation_looks": len(held.misses_mm),
        "before_mm": held.before_mm,
        "error_mm": held.error_mm,
        "predicted_mm": held.predicted_mm,
        "model_mm": held.model_mm,
        "scatter_mm": fit.scatter_mm,
        "tool_shift_mm": result.tool_shift_mm,
        "parameters": {
            name: {"value": float(value), "standard_error": float(error)}
            for name, value, error in zip(fit.model.names, fit.values, fit.learnt, strict=False)
        },
    }


def check_payload(result: ArmCheck) -> dict[str, Any]:
    """The figures of a check as plain numbers."""
    return {
        "calibration": result.calibration,
        "passed": result.passed,
        "looks": result.looks,
        "error_mm": result.error_mm,
        "expected_mm": result.expected_mm,
        "statistic": result.statistic,
        "limit": result.limit,
    }
