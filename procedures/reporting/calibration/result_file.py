"""`result.json`: figures of a calibration, a check or a measurement, as the command's `--json` prints them.

The kind of the figures is recognized by a key that no other kind has. A key `kind` would be new in the output
of `--json`, and files written before it would still have to be recognized by their content.
"""

from __future__ import annotations

import json
from pathlib import Path

from procedures.reporting.calibration.arm import ArmCheckFigures, ArmFigures
from procedures.reporting.calibration.ball import BallFigures
from procedures.reporting.calibration.figures import Figures
from procedures.reporting.calibration.mount import FrameFigures, TipFigures
from procedures.reporting.calibration.stereo_head import HeadCheckFigures, HeadFigures
from ronna_hw.bounded_input import parse_json, read_json_bytes
from ronna_hw.records import write_whole

RESULT_FILE = "result.json"  # in the folder of the run
KINDS: dict[str, type[Figures]] = {
    "residuals_px": HeadFigures,
    "signs": HeadCheckFigures,
    "position_mm": BallFigures,
    "parameters": ArmFigures,
    "expected_mm": ArmCheckFigures,
    "tool_from_marker": FrameFigures,
    "tip_in_head_mm": TipFigures,
}


def write_figures(figures: Figures, folder: Path) -> None:
    """Write them for the report."""
    content = json.dumps(figures.as_json(), indent=1, allow_nan=False)
    write_whole(folder / RESULT_FILE, content.encode())


def read_figures(folder: Path) -> Figures:
    """What the command wrote. Raises OSError, and ValueError for anything else."""
    content = read_json_bytes(folder / RESULT_FILE)
    found = parse_json(content)
    for key, kind in KINDS.items():
        if isinstance(found, dict) and key in found:
            return kind.model_validate_json(content)
    raise ValueError("it has no figures of a calibration")


def figures_if_readable(folder: Path) -> Figures | None:
    """The same for a report; None if there is nothing, or nothing readable."""
    try:
        return read_figures(folder)
    except (OSError, ValueError):
        return None
