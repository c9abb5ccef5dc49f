"""Calibration of stereo head, arm, tracked frame and tool tip: fits and records.

Pure numerics.
"""

from procedures.calibration.bundle import BundleFit, fit_bundle
from procedures.calibration.head_calibration import HeadResult, calibrate_head
from procedures.calibration.observations import Observation, ObservationSet, Outline
from procedures.calibration.self_check import Baseline, CheckResult, compare_with_baseline

__all__ = [
    "Baseline",
    "BundleFit",
    "CheckResult",
    "HeadResult",
    "Observation",
    "ObservationSet",
    "Outline",
    "calibrate_head",
    "compare_with_baseline",
    "fit_bundle",
]
