"""Every pose of the built-in scenes is within reach and away from singularities."""

import math

import pytest

from procedures.planning.paths import check_paths
from procedures.planning.visits import ArmSetting
from procedures.strategies.catalogue import strategy_named
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.frames import Frame
from sim.world.scene.named_scenes import named_scene

LEAST_BEND_RAD = math.radians(4.0)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    ("name", "markers", "targets"), [("default", 5, 3), ("default", 8, 6), ("mini", 3, 1)]
)
def test_every_pose_of_a_built_in_scene_is_within_reach_and_away_from_singularities(
    name: str, markers: int, targets: int, seed: int
) -> None:
    scene = named_scene(name, seed=seed, markers=markers, targets=targets)
    setting = ArmSetting(
        kr6_r900(scene.arm.variant),
        scene.head.robot_from_ct.transform(Frame.ROBOT, Frame.CT),
        scene.mount.flange_from_tool_nominal.transform(Frame.FLANGE, Frame.TOOL),
        strategy_named("ocs"),
        start_rad=radians6(*scene.arm.home_deg),
        limits=working_limits(kr6_r900(scene.arm.variant)),
    )
    trajectories = [Trajectory(t.identifier, t.entry_ct_mm, t.target_ct_mm) for t in scene.head.targets]
    check = check_paths(setting, trajectories, [f.centre_ct_mm for f in scene.head.fiducials])
    assert check.passed, check.unmet
    assert min(setting.kinematics.wrist_bend_rad(one.at_rad) for one in check.reached) > LEAST_BEND_RAD
