"""The arm's own errors between spheres and target, joint by joint, so that what they share cancels.

Where a strategy does not control the approach, the servo's last step, not the way to the sphere, leaves each
joint on one side of its backlash, and nobody knows on which. What the servo leaves is measured.

The record of the arm says how large they are: up to those of an uncalibrated arm, in proportion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_sources import ArmPoses, arm_sources
from procedures.engine.context import StepContext
from procedures.registration.target_prediction import OwnErrors, SharedErrors
from procedures.steps.clinical.error_budget.held_guide import HeldGuide
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.relocalization import arriving
from ronna_hw.arm.error_budget import ErrorSizes, backlash_mm2

Array = NDArray[np.float64]


def arm_errors(
    context: StepContext, fiducials: Sequence[int], spheres_mm: Array, target: str, held: HeldGuide
) -> tuple[SharedErrors | OwnErrors, ...]:
    """Of localizations of spheres (n, 3) mm, robot frame, as planned, and of the tip at a target."""
    paths = context.result(CheckedPaths)
    joints_rad = _planned_rad(context, fiducials)
    signs = arriving(context, paths)
    sides = None if signs is None else np.array([signs] * len(joints_rad), dtype=float)
    return arm_sources(
        context.workcell.arm.kinematics.chain,
        ArmPoses(joints_rad, spheres_mm, sides),
        ArmPoses(
            np.array([held.joints_rad]),
            held.tip_mm[None],
            np.array([paths.targets[target].approach_signs], dtype=float),
        ),
        ErrorSizes.stated(context.setting.settings, context.workcell.calibrations.arm),
        servo_mm=0.0,
    )


def unknown_sides_mm2(context: StepContext, fiducials: Sequence[int], spheres_mm: Array) -> Array:
    """Covariances (n, 3, 3) of spheres where no strategy says on which side of its backlash a joint rests.

    Of a calibrated arm: what is said of one that is not calibrated has it already.
    """
    arm = context.workcell.calibrations.arm
    if arm is None or arriving(context, context.result(CheckedPaths)) is not None:
        return np.zeros((len(fiducials), 3, 3))
    sizes = ErrorSizes.stated(context.setting.settings, arm)
    chain = context.workcell.arm.kinematics.chain
    return backlash_mm2(chain, _planned_rad(context, fiducials), spheres_mm, sizes)


def _planned_rad(context: StepContext, fiducials: Sequence[int]) -> Array:
    """Joints (n, axes) of the localizations as planned."""
    localizations = context.result(CheckedPaths).localizations_for(context.key.trajectory)
    planned = {one.fiducial: one.joints_rad for one in localizations}
    return np.array([planned[index] for index in fiducials])
