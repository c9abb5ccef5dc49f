"""The error of the tool frame on the flange, as spheres and targets share it.

Turned with the tool, it displaces every localized sphere and the tip. Where the tool is held alike, all are
displaced alike and nothing of it is left; that is what the strategies differ in.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_sources import ErrorSizes
from procedures.engine.context import StepContext
from procedures.registration.target_prediction import SharedErrors
from procedures.steps.clinical.error_budget.held_guide import HeldGuide
from procedures.steps.clinical.path_check import CheckedPaths

Array = NDArray[np.float64]

SOURCE = "tool frame"


def displaced_spheres_mm(context: StepContext, fiducials: Sequence[int]) -> Array:
    """How far each standard deviation of the tool frame displaces the spheres, (n, 3, 3) mm, robot frame."""
    planned = context.result(CheckedPaths).localizations_for(context.key.trajectory)
    rotations = {one.fiducial: one.tool_pose.transform.rotation_matrix for one in planned}
    return _error_mm(context) * np.array([rotations[index] for index in fiducials])


def shared_with_target(context: StepContext, spheres_mm: Array, held: HeldGuide) -> SharedErrors:
    """The same with the tip at a target; `spheres_mm` as above."""
    return SharedErrors(SOURCE, spheres_mm, _error_mm(context) * held.rotation)


def _error_mm(context: StepContext) -> float:
    return ErrorSizes.stated(context.setting.settings, context.workcell.calibrations.arm).tool_mm
