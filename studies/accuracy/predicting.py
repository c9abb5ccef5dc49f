"""Joint-level prediction of a strategy's target errors, for the remaining part of parameter set S."""

from __future__ import annotations

import numpy as np

from procedures.calibration.arm_sources import ArmPoses, arm_sources, ct_errors
from procedures.registration.target_prediction import TargetPrediction, predict_target_error
from ronna_hw.arm.error_budget import UNCALIBRATED, ErrorSizes
from ronna_hw.frames import Transform
from studies.accuracy.phantom import Phantom
from studies.accuracy.postures import ARM, Postures
from studies.accuracy.trials import AXES, CT_FLE_MM


def predictions(
    planned: Postures,
    phantom: Phantom,
    robot_from_ct: Transform,
    count: int,
    left: ErrorSizes = UNCALIBRATED,
    ct_mm: float = CT_FLE_MM,
) -> list[TargetPrediction]:
    """One per target, with the first `count` spheres; the fit is unweighted."""
    spheres = robot_from_ct.apply(phantom.spheres_mm)
    found = []
    for number, trajectory in enumerate(phantom.trajectories):
        first = planned.set_of(number) * len(spheres)
        looks = slice(first, first + count)
        target = robot_from_ct.apply(trajectory.target_mm)
        at_spheres = ArmPoses(
            planned.localizations.joints_rad[looks],
            spheres[:count],
            planned.arrival[looks],
        )
        at_target = ArmPoses(
            planned.targets.joints_rad[[number]],
            target[None],
            planned.target_arrival[[number]],
        )
        ct = np.tile(np.eye(AXES) * ct_mm**2 / AXES, (count, 1, 1))
        sources = [
            *arm_sources(ARM.chain, at_spheres, at_target, left),
            ct_errors(ct),
        ]
        found.append(predict_target_error(spheres[:count], target, sources))
    return found
