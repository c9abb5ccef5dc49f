"""For `best`: the strategy of each trajectory, by the error that is predicted at the poses it would use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from procedures.calibration.arm_sources import ArmPoses, arm_sources, tool_frame
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.sight import StereoSight
from procedures.planning.visits import ArmSetting, PathCheck, VisitKind
from procedures.registration.target_prediction import predict_target_error
from procedures.strategies.approach import arrival_signs
from procedures.strategies.best import CANDIDATES, BestOfEach
from procedures.strategies.trajectory import Trajectory


def with_best_chosen(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, sight: StereoSight
) -> ArmSetting:
    """The setting with the strategy `best` decided for each trajectory; any other strategy is left as it is.

    Trajectories and fiducials (n, 3) are in CT mm. Only what is seen, reached and clear is a candidate.
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
    """Rms of what the arm's own errors leave at the target of a trajectory, from the check of it alone.

    The instrument's tip is there, wherever on the axis the guide is held. CT and stereo head err alike in
    whatever orientation. For strategies that control the approach.
    """
    looks = [one for one in check.reached if one.visit.kind is VisitKind.LOCALIZATION]
    (target,) = (one for one in check.reached if one.visit.kind is VisitKind.TARGET)
    signs = np.array(
        [arrival_signs(setting.kinematics, target.visit.pose, target.at_rad, setting.flange_from_tool)]
    ).astype(float)
    spheres = np.array([one.visit.pose.translation_mm for one in looks])
    tip = np.asarray(setting.robot_from_ct.apply(trajectory.target_mm))
    rotations = np.array([one.visit.pose.rotation_matrix for one in looks])
    sources = [
        tool_frame(rotations, target.visit.pose.rotation_matrix, setting.sizes.tool_mm),
        *arm_sources(
            setting.kinematics.chain,
            ArmPoses(np.array([one.at_rad for one in looks]), spheres, np.repeat(signs, len(looks), axis=0)),
            ArmPoses(np.array([target.at_rad]), tip[None], signs),
            setting.sizes,
            servo_mm=0.0,
        ),
    ]
    return predict_target_error(spheres, tip, sources).rms_mm
