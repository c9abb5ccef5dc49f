"""The arm's own errors between spheres and target, joint by joint, so that what they share cancels.

Where a strategy does not control the approach, the servo's last step, not the way to the sphere, leaves each
joint on one side of its backlash, and nobody knows on which. What the servo leaves is measured.

The record of the arm says how large they are: up to those of an uncalibrated arm, in proportion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_sources import ArmPoses, ErrorSizes, arm_sources
from procedures.engine.context import StepContext
from procedures.registration.target_prediction import OwnErrors, SharedErrors
from procedures.steps.clinical.error_budget.held_guide import HeldGuide
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.relocalization import arriving

Array = NDArray[np.float64]


def arm_errors(
    context: StepContext, fiducials: Sequence[int], spheres_mm: Array, target: str, held: HeldGuide
) -> tuple[SharedErrors | OwnErrors, ...]:
    """Of localizations of spheres (n, 3) mm, robot frame, as planned, and of the tip at a target."""
    paths = context.result(CheckedPaths)
    planned = {one.fiducial: one for one in paths.localizations_for(context.key.trajectory)}
    looks = [planned[index] for index in fiducials]
    signs = arriving(context, paths)
    sides = None if signs is None else np.array([signs] * len(looks), dtype=float)
    return arm_sources(
        context.workcell.arm.kinematics.chain,
        ArmPoses(np.array([one.joints_rad for one in looks]), spheres_mm, sides),
        ArmPoses(
            np.array([held.joints_rad]),
            held.tip_mm[None],
            np.array([paths.targets[target].approach_signs], dtype=float),
        ),
        ErrorSizes.stated(context.setting.settings, context.workcell.calibrations.arm),
        servo_mm=0.0,
    )
