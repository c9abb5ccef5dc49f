"""Runs a calibration of the reference frame, or computes one again, and leaves its files.

OUT/<id>/frame-looks.json    what arm and tracker said at each pose; calibrate again with --from
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

from procedures.calibration.observations import read_strict
from procedures.calibration.tracker_frame.looks import LOOKS_FILE, FrameLooks
from procedures.calibration.tracker_frame.record import FrameResult, calibrate_frame
from procedures.cli.calibrating.files import write_payload, write_records, write_theatre
from procedures.cli.calibrating.running import concluded, new_folder, run_steps, valid_now
from procedures.cli.case.request import TheatreRequest
from procedures.engine.engine import Engine
from procedures.reporting.calibration import FrameFigures
from ronna_hw.command_line import console
from ronna_hw.records import write_whole


def calibrate_tracker_frame(
    request: TheatreRequest | None,
    recorded: Path | None,
    numbers: tuple[int, int],
    *,
    life: timedelta,
    write: Path | None,
    out: Path,
    as_json: bool,
) -> None:
    """From so many poses, and so many more to judge by; or from `recorded`. Raises CAL-002 to CAL-017."""
    observed = None if recorded is None else read_looks(recorded)
    folder = new_folder(out, "tracker-frame")

    def conclude(observed: FrameLooks) -> FrameResult:
        write_whole(folder / LOOKS_FILE, observed.model_dump_json(by_alias=True, indent=1).encode())
        result = calibrate_frame(observed, life=life)
        write_records(records_of(result), folder)
        write_payload(payload_of(result), folder)
        return result

    def look(then: Callable[[FrameLooks], None]) -> None:
        assert request is not None, "without recorded looks there is a theatre"
        _look(request, folder, numbers, then)

    result = concluded(folder, observed, look, conclude)
    if write is not None and request is not None and request.config is not None:
        write_theatre(request.config, write, records_of(result))
    if as_json:
        console.print_json({**payload_of(result), "folder": str(folder)})
        return
    figures = FrameFigures.model_validate(payload_of(result)).figures()
    console.print_table(
        f"calibration {result.tracker_frame.identifier}",
        ["", "value", "standard error"],
        [[one.name, one.value, one.spread] for one in figures],
    )
    console.tell(f"record in {folder}: put calibration.toml into the theatre file, or use --write")


def read_looks(path: Path) -> FrameLooks:
    """Stored looks, from their file or folder. Raises CAL-005."""
    return read_strict(FrameLooks, path / LOOKS_FILE if path.is_dir() else path)


def records_of(result: FrameResult) -> dict[str, Any]:
    """The new record by the name that the theatre file has for it."""
    return {"tracker_frame": result.tracker_frame.model_dump()}


def payload_of(result: FrameResult) -> dict[str, Any]:
    """The figures of a calibration as plain numbers."""
    fit, record = result.fit, result.tracker_frame
    return {
        "calibration": record.identifier,
        "created": record.created.isoformat(),
        "expires": record.expires.isoformat(),
        "frame": record.tool,
        "poses": len(fit.used),
        "outliers": int((~fit.used).sum()),
        "validation_poses": len(result.misses_mm),
        "tool_from_marker": record.tool_from_marker.model_dump(),
        "flange_from_marker": fit.flange_from_marker.tolist(),
        "error_mm": fit.error_mm,
        "error_rad": fit.error_rad,
        "arm_error_mm": result.arm_error_mm,
        "stated_error_mm": record.stated_error_mm,
        "scatter_mm": fit.scatter_mm,
        "scatter_rad": fit.scatter_rad,
        "validation_mm": _rms(result.misses_mm.tolist()),
        "validation_rad": _rms(result.misses_rad.tolist()),
        "predicted_mm": result.predicted_mm,
        "predicted_rad": result.predicted_rad,
        "change_mm": result.change_mm,
        "change_rad": result.change_rad,
    }


def _rms(misses: list[list[float]]) -> float:
    return math.sqrt(sum(math.hypot(*one) ** 2 for one in misses) / len(misses))


def _look(
    request: TheatreRequest,
    folder: Path,
    numbers: tuple[int, int],
    conclude: Callable[[FrameLooks], None],
) -> None:
    """Look at the frame; what `conclude` raises is how the run has ended."""
    from procedures.steps.calibration.frame_looks import ObservedFrame
    from procedures.steps.calibration.procedures import frame_looks

    def judge(engine: Engine) -> None:
        conclude(engine.case.get(ObservedFrame).result.observed)

    with console.progress_bar("turning the reference frame") as advance:
        engine = run_steps(
            request,
            folder,
            frame_looks(*numbers),
            advance,
            title="Calibration of the reference frame",
            in_use=lambda given: valid_now(given, "tracker_frame", "tool_tip"),
            judge=judge,
        )
    for remark in engine.case.get(ObservedFrame).result.remarks:
        console.tell(remark)
