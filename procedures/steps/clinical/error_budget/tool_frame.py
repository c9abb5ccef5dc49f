"""The error of the tool frame on the flange: turned with the tool, it displaces every localized sphere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from procedures.engine.context import StepContext
from procedures.steps.clinical.path_check import CheckedPaths
from ronna_hw.arm.error_budget import ErrorSizes

Array = NDArray[np.float64]


def displaced_spheres_mm(context: StepContext, fiducials: Sequence[int]) -> Array:
    """How far each standard deviation of the tool frame displaces the spheres, (n, 3, 3) mm, robot frame."""
    planned = context.result(CheckedPaths).localizations_for(context.key.trajectory)
    rotations = {one.fiducial: one.tool_pose.transform.rotation_matrix for one in planned}
    sizes = ErrorSizes.stated(context.setting.settings, context.workcell.calibrations.arm)
    return sizes.tool_mm * np.array([rotations[index] for index in fiducials])
