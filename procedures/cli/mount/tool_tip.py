"""Runs a calibration of the guide's tip, or computes one again, and leaves its files.

OUT/<id>/tip-looks.json    what head and dials said in each orientation; calibrate again with --from
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

from procedures.calibration.observations import read_strict
from procedures.calibration.tool_tip.looks import LOOKS_FILE, TipLooks
from procedures.calibration.tool_tip.record import TipResult, calibrate_tip
from procedures.cli.calibrating.files import write_payload, write_records, write_theatre
from procedures.cli.calibrating.running import concluded, new_folder, run_steps, valid_now
from procedures.cli.case.request import TheatreRequest
from procedures.engine.engine import Engine
from procedures.reporting.calibration import TipFigures
from ronna_hw.calibration import Numbers3
from ronna_hw.command_line import console
from ronna_hw.records import write_whole


def calibrate_tool_tip(
    request: TheatreRequest | None,
    recorded: Path | None,
    numbers: tuple[int, int],
    ball_mm: Numbers3 | None,
    *,
    life: timedelta,
    write: Path | None,
    out: Path,
    as_json: bool,
) -> None:
    """Read so many, and so many more to judge by; or compute from `recorded`. Raises CAL-002 to CAL-019."""
    observed = None if recorded is None else read_looks(recorded)
    folder = new_folder(out, "tool-tip")

    def conclude(observed: TipLooks) -> TipResult:
        write_whole(folder / LOOKS_FILE, observed.model_dump_json(by_alias=True, indent=1).encode())
        result = calibrate_tip(observed, life=life)
        write_records(records_of(result), folder)
        write_payload(payload_of(result), folder)
        return result

    def look(then: Callable[[TipLooks], None]) -> None:
        assert request is not None, "without recorded readings there is a theatre"
        _read(request, folder, numbers, ball_mm, then)

    result = concluded(folder, observed, look, conclude)
    if write is not None and request is not None and request.config is not None:
        write_theatre(request.config, write, records_of(result))
    if as_json:
        console.print_json({**payload_of(result), "folder": str(folder)})
        return
    figures = TipFigures.model_validate(payload_of(result)).figures()
    console.print_table(
        f"calibration {result.tool_tip.identifier}",
        ["", "value", "standard error"],
        [[one.name, one.value, one.spread] for one in figures],
    )
    console.tell(f"record in {folder}: put calibration.toml into the theatre file, or use --write")


def read_looks(path: Path) -> TipLooks:
    """Stored looks and readings, from their file or folder. Raises CAL-005."""
    return read_strict(TipLooks, path / LOOKS_FILE if path.is_dir() else path)


def records_of(result: TipResult) -> dict[str, Any]:
    """The new record by the name that the theatre file has for it."""
    return {"tool_tip": result.tool_tip.model_dump()}


def payload_of(result: TipResult) -> dict[str, Any]:
    """The figures of a calibration as plain numbers."""
    fit, record = result.fit, result.tool_tip
    missed = [math.hypot(*one) ** 2 for one in result.misses_mm.tolist()]
    return {
        "calibration": record.identifier,
        "created": record.created.isoformat(),
        "expires": record.expires.isoformat(),
        "tool_number": record.tool_number,
        "readings": len(fit.misses_mm),
        "validation_readings": len(missed),
        "tip_in_head_mm": fit.tip_mm.tolist(),
        "flange_from_tool": record.flange_from_tool.model_dump(),
        "error_mm": math.sqrt(float(fit.covariance_mm2.trace())),
        "stated_error_mm": record.stated_error_mm,
        "reading_scatter_mm": fit.scatter_mm,
        "validation_mm": math.sqrt(sum(missed) / len(missed)),
        "predicted_mm": result.predicted_mm,
        "gap_mm": fit.gap_mm.tolist(),
        "gap_error_mm": fit.gap_error_mm,
        "change_mm": result.change_mm,
    }


def _read(
    request: TheatreRequest,
    folder: Path,
    numbers: tuple[int, int],
    ball_mm: Numbers3 | None,
    conclude: Callable[[TipLooks], None],
) -> None:
    """Look and read; what `conclude` raises is how the run has ended."""
    from procedures.steps.calibration.procedures import tip_readings
    from procedures.steps.calibration.stand_ball import ObservedStand
    from procedures.steps.calibration.tip_readings import ReadTip

    def judge(engine: Engine) -> None:
        conclude(engine.case.get(ReadTip).result.observed)

    with console.progress_bar("looking at the ball, reading the divot") as advance:
        engine = run_steps(
            request,
            folder,
            tip_readings(*numbers, ball_mm),
            advance,
            title="Calibration of the guide's tip",
            in_use=lambda given: valid_now(given, "tool_tip", "tracker_frame"),
            judge=judge,
        )
    for remark in engine.case.get(ObservedStand).result.remarks:
        console.tell(remark)
    console.tell("the guide hangs on the arm: mount the stereo head before the next case")
