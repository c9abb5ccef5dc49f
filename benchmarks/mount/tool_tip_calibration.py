"""Calibration of the guide's tip relative to the stereo head, over random arms, heads and stands, in process.

`relative to the head's measurement`: against the position at which the head, with its record, would see a
ball at the true tip, of the guide as it was seated at the stand: each mounting adds the changer's own
repeatability. A case depends on this error, as it localizes with that head and record. `relative to the true
tool centre` also includes the error of the head's record.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure
from benchmarks.mount.tip_looks import TipCell
from procedures.calibration.tip_calibration import calibrate_tip

Array = NDArray[np.float64]

SEEDS = 20
READINGS, VALIDATION = 10, 3
WHO = "ronna-procedure calibrate tool-tip"
GOAL_MM = 0.05


def measure() -> list[Figure]:
    """Errors over the seeds, with a calibrated arm and with an uncalibrated one."""
    return [*_figures(True), *_figures(False)]


def _figures(calibrated: bool) -> list[Figure]:
    rows = np.array([_errors(seed, calibrated) for seed in range(SEEDS)])
    arm = "calibrated arm" if calibrated else "uncalibrated arm"
    figures = []
    for column, what in enumerate(("relative to the head's measurement", "relative to the true tool centre")):
        errors = rows[:, column]
        rms = float(np.sqrt(np.mean(errors**2)))
        figures.append(
            Figure(f"tool tip, {arm}: largest error, {what}", WHO, float(errors.max()), "mm").at_most(GOAL_MM)
        )
        figures.append(Figure(f"tool tip, {arm}: rms error, {what}", WHO, rms, "mm"))
    ratio = float(np.sqrt(np.mean((rows[:, 0] / rows[:, 2]) ** 2)))
    figures.append(Figure(f"tool tip, {arm}: made over stated error", WHO, ratio, ""))
    return figures


def _errors(seed: int, calibrated: bool) -> tuple[float, float, float]:
    """Errors relative to the head's measurement and to the true tool centre, and the stated one, mm."""
    cell = TipCell.of(seed, calibrated=calibrated)
    result = calibrate_tip(cell.readings(READINGS, VALIDATION))
    true = cell.true_tip_mm
    found = result.fit.tip_mm
    return (
        float(np.linalg.norm(found - cell.seen_mm(true))),
        float(np.linalg.norm(found - true)),
        result.tool_tip.stated_error_mm,
    )
