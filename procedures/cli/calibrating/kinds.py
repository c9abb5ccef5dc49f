"""The kinds of calibration by what they are of."""

from __future__ import annotations

from typing import Any

from procedures.cli.calibrating.calibration import CalibrationKind
from procedures.steps.calibration.recipe import Calibrated


def kind_of(calibrated: Calibrated) -> CalibrationKind[Any, Any]:
    """What is observed, computed and kept for it."""
    from procedures.cli.arm import files as arm
    from procedures.cli.mount import tool_tip, tracker_frame
    from procedures.cli.stereo import files as stereo

    kinds: dict[Calibrated, CalibrationKind[Any, Any]] = {
        Calibrated.HEAD: stereo.KIND,
        Calibrated.ARM: arm.KIND,
        Calibrated.FRAME: tracker_frame.KIND,
        Calibrated.TIP: tool_tip.KIND,
    }
    return kinds[calibrated]
