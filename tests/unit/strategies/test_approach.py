"""Each joint arrives at a pose in the direction of the last stretch along the tool axis."""

import numpy as np
from strategy_arms import ARM

from procedures.strategies.strategy import arrival_signs
from procedures.strategies.trajectory import back_along_axis


def test_the_arrival_direction_is_that_of_the_last_stretch_along_the_axis():
    at = (0.3, -1.2, 1.9, 0.4, 0.9, 2.8)
    pose = ARM.stereo_pose(at)
    before = np.array(ARM.guide_at(back_along_axis(pose, 1.0)))
    signs = arrival_signs(ARM.kinematics, pose, at, ARM.flange_from_stereo)
    assert signs == tuple(np.where(np.array(at) >= before, 1, -1))
