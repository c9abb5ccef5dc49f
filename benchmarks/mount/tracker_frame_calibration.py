"""Calibration of the reference frame on the mount, over random arms and trackers, in process.

Two references. `as on this arm` is the result of an error-free tracker with the same arm and record: this is
the error due to the procedure itself. `as designed` is the position on the flange in the scene; it differs
from the first by the error of the arm's last links, which no measurement with that arm can distinguish from a
shift of the frame, and which cancels wherever the record is used with the arm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.figures import Figure
from benchmarks.mount.frame_looks import FrameCell
from procedures.calibration.frame_calibration import FrameResult, Use, calibrate_frame, pairs_of
from procedures.calibration.hand_eye import solve

Array = NDArray[np.float64]

SEEDS = 20
LOOKS, VALIDATION = 30, 10
WHO = "ronna-procedure calibrate tracker-frame"
GOAL_MM, GOAL_DEG = 0.15, 0.05


def measure() -> list[Figure]:
    """Errors over the seeds, with a calibrated arm and with an uncalibrated one."""
    return [*_figures(True), *_figures(False)]


def _figures(calibrated: bool) -> list[Figure]:
    rows = np.array([_errors(seed, calibrated) for seed in range(SEEDS)])
    arm = "calibrated arm" if calibrated else "uncalibrated arm"
    figures = []
    for column, (what, unit) in enumerate(
        (truth, unit) for truth in ("as on this arm", "as designed") for unit in ("mm", "°")
    ):
        errors = rows[:, column]
        rms = float(np.sqrt(np.mean(errors**2)))
        figure = Figure(f"tracker frame, {arm}: largest error, {what}", WHO, float(errors.max()), unit)
        figures.append(figure.at_most(GOAL_MM if unit == "mm" else GOAL_DEG) if column < 2 else figure)
        figures.append(Figure(f"tracker frame, {arm}: rms error, {what}", WHO, rms, unit))
    made, stated = rows[:, 2], rows[:, 4]
    ratio = float(np.sqrt(np.mean((made / stated) ** 2)))
    figures.append(Figure(f"tracker frame, {arm}: made over stated error", WHO, ratio, ""))
    return figures


def _errors(seed: int, calibrated: bool) -> tuple[float, float, float, float, float]:
    """Errors (mm, degrees) as this arm has the frame and as it is drawn, and the stated one (mm)."""
    cell = FrameCell.of(seed, calibrated=calibrated)
    result = calibrate_frame(cell.looks(LOOKS, VALIDATION))
    found = result.fit.flange_from_marker
    exact = FrameCell.of(seed, calibrated=calibrated, exact=True).looks(LOOKS, VALIDATION)
    as_arm_has_it = solve(pairs_of([one for one in exact.looks if one.use is not Use.RETURN]))
    own = apart(found, as_arm_has_it.flange_from_marker)
    return (*own, *apart(found, cell.true_frame), _stated_mm(result))


def apart(one: Array, other: Array) -> tuple[float, float]:
    """Difference between two poses, in mm and degrees."""
    turn = Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude()
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), float(np.degrees(turn))


def _stated_mm(result: FrameResult) -> float:
    return result.tracker_frame.stated_error_mm
