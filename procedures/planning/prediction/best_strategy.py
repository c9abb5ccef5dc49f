"""For `best`: the strategy of each trajectory, by the predicted error at the poses it would use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.path_check.free_angle import choose_free_angles
from procedures.planning.path_check.visits import ArmSetting, PathCheck
from procedures.planning.prediction.target_error import arm_error_sources, poses_for
from procedures.planning.sight.stereo_head import StereoSight
from procedures.registration.target_prediction import predict_target_error
from procedures.strategies.catalogue import CANDIDATES, BestOfEach
from procedures.strategies.trajectory import Trajectory


def with_best_chosen(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, sight: StereoSight
) -> ArmSetting:
    """The setting with the strategy `best` resolved for each trajectory; other strategies are unchanged.

    Trajectories and fiducials (n, 3) are in CT mm. Only what is visible, reachable and clear is a candidate.
    """
    if not isinstance(setting.strategy, BestOfEach):
        return setting
    chosen = {}
    for one in trajectories:
        predicted_mm = {}
        for candidate in CANDIDATES:
            alone = replace(setting, strategy=candidate)
            turned = choose_free_angles(alone, (one,), fiducials_mm, sight)
            if turned.check.passed:
                predicted_mm[candidate] = predicted_arm_error_mm(alone, turned.check, one)
        if predicted_mm:
            chosen[one.identifier] = min(predicted_mm, key=lambda name: predicted_mm[name])
    return replace(setting, strategy=replace(setting.strategy, others=chosen))


def predicted_arm_error_mm(setting: ArmSetting, check: PathCheck, trajectory: Trajectory) -> float:
    """Rms of the arm's own errors at a trajectory's target, from a check of that trajectory alone.

    Evaluated at the instrument's tip, wherever on the axis the guide is held. Errors of CT and stereo head do
    not depend on the orientation.
    """
    looks, target = poses_for(setting, check, trajectory.identifier)
    spheres = np.array([one.visit.pose.translation_mm for one in looks])
    tip = np.asarray(setting.robot_from_ct.apply(trajectory.target_mm))
    return predict_target_error(spheres, tip, arm_error_sources(setting, looks, target, tip)).rms_mm
