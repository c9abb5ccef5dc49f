"""Drawn plans are within reach of the arm, away from singularities, and accepted by the planner."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from procedures.planning.free_angle import choose_free_angles
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.paths import check_paths
from procedures.planning.scene import PlanningScene
from procedures.planning.visits import ArmSetting
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.catalogue import ArmChoice, find_arm
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.pose import radians6
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.frames import Frame
from sim.world.rigid import apply, inverse, matrix_of
from sim.world.scene.arm_design import KR6
from sim.world.scene.head import draw_head
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene, scene_generator
from sim.world.scene.parts import Guide
from sim.world.scene.plan_feasibility import STANDOFF_MM, PlanFeasibility

LEAST_BEND_RAD = math.radians(4.0)


def setting_of(scene: Scene) -> ArmSetting:
    arm = find_arm(scene.arm.variant).kinematics
    return ArmSetting(
        arm,
        scene.head.robot_from_ct.transform(Frame.ROBOT, Frame.CT),
        scene.mount.flange_from_tool_nominal.transform(Frame.FLANGE, Frame.TOOL),
        find_strategy("ocs"),
        start_rad=radians6(*scene.arm.home_deg),
        limits=working_limits(arm),
    )


def trajectories_of(scene: Scene) -> list[Trajectory]:
    return [Trajectory(t.identifier, t.entry_ct_mm, t.target_ct_mm) for t in scene.head.targets]


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 8))]
)
@pytest.mark.parametrize(
    ("name", "markers", "targets"), [("default", 5, 3), ("default", 8, 6), ("mini", 3, 1)]
)
def test_every_pose_of_a_built_in_scene_is_within_reach_and_away_from_singularities(
    name: str, markers: int, targets: int, seed: int
) -> None:
    scene = draw_scene(name, seed=seed, markers=markers, targets=targets)
    setting, trajectories = setting_of(scene), trajectories_of(scene)
    check = check_paths(setting, trajectories, [f.centre_ct_mm for f in scene.head.fiducials])
    assert check.passed, check.unmet
    assert min(setting.kinematics.wrist_bend_rad(one.at_rad) for one in check.reached) > LEAST_BEND_RAD


ONCE_OUT_OF_REACH = 104  # seed whose third trajectory was once beyond the range of A5


def turned(vector: np.ndarray, about_z_rad: float) -> np.ndarray:
    cosine, sine = np.cos(about_z_rad), np.sin(about_z_rad)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ vector


def reach_of(scene: Scene) -> tuple[PlanFeasibility, list[tuple[np.ndarray, np.ndarray]]]:
    """The feasibility check of a scene, and its trajectories in the robot frame."""
    place = matrix_of(scene.head.robot_from_ct)
    spheres = apply(place, [fiducial.centre_ct_mm for fiducial in scene.head.fiducials])
    ends = [(apply(place, t.entry_ct_mm), apply(place, t.target_ct_mm)) for t in scene.head.targets]
    return PlanFeasibility(spheres, scene.arm.variant), ends


@pytest.mark.parametrize("markers", [3, 5, 8])
def test_every_seed_draws_a_plan_within_reach(markers: int) -> None:
    for seed in range(100, 104):
        reach, ends = reach_of(draw_scene("default", seed=seed, markers=markers))
        assert reach.is_feasible(ends)


def test_trajectories_that_the_arm_cannot_take_are_passed_over_and_counted() -> None:
    for seed, passed_over in ((0, 0), (ONCE_OUT_OF_REACH, 1)):
        drawn = draw_head(scene_generator(seed), 5, 3)
        assert drawn.passed_over == passed_over
        assert drawn.head.targets == draw_scene("default", seed=seed).head.targets


def test_a_trajectory_from_below_is_out_of_reach() -> None:
    reach, ends = reach_of(draw_scene("default", seed=0))
    (entry, target), *_ = ends
    assert reach.is_feasible([(entry, target)])
    assert not reach.is_feasible([(target, entry)])  # the same line from the other side of the head
    assert not reach.is_feasible([ends[0], (target, entry)])


def test_a_trajectory_is_infeasible_if_one_sphere_hides_another_in_every_turn() -> None:
    """Two spheres in line with a camera: no turn about a vertical trajectory may use that line."""
    apart, below = np.array([45.0, 0.0, 0.0]), np.array([700.0, 0.0, 250.0])
    crowded = below + np.array([[0.0, 0.0, 0.0], *(turned(apart, k * np.pi / 18.0) for k in range(36))])
    down = (below + np.array([20.0, 20.0, 80.0]), below + np.array([20.0, 20.0, 20.0]))
    assert not PlanFeasibility(crowded, KR6.variant).is_feasible([down])
    assert PlanFeasibility(crowded[:2], KR6.variant).is_feasible([down])


@pytest.mark.parametrize("seed", [0, ONCE_OUT_OF_REACH])
def test_the_planner_accepts_the_drawn_plans(seed: int) -> None:
    accept(draw_scene("default", seed=seed, markers=5, targets=3))


@pytest.mark.parametrize("arm", [ArmChoice.UR5, ArmChoice.UR5E])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 20))])
def test_another_arm_has_scenes_of_its_own_and_clears_everything_in_them(arm: ArmChoice, seed: int) -> None:
    accept(draw_scene("default", seed=seed, arm=arm), among_bodies=True)


@pytest.mark.slow  # 43 s of CPU
@pytest.mark.timeout(300)
def test_the_planner_accepts_eight_markers_and_ten_targets_of_a_hundred_seeds() -> None:
    for seed in range(100):
        scene = draw_scene("default", seed=seed, markers=8, targets=10)
        assert (len(scene.head.fiducials), len(scene.head.targets)) == (8, 10)
        accept(scene)


def hold_guide_outside(trajectory: Trajectory) -> Trajectory:
    depth_mm = math.dist(trajectory.entry_mm, trajectory.target_mm)
    return trajectory.with_rest(Guide().reach_mm - STANDOFF_MM - depth_mm, STANDOFF_MM)


def accept(scene: Scene, *, among_bodies: bool = False) -> None:
    """Plan the drawn trajectories with the planner, which raises if it refuses them."""
    setting, trajectories = setting_of(scene), trajectories_of(scene)
    if among_bodies:
        head = HeadEllipsoid(centre_mm=scene.head.centre_ct_mm, semi_axes_mm=scene.head.semi_axes_mm)
        spheres = tuple(fiducial.centre_ct_mm for fiducial in scene.head.fiducials)
        setting = replace(setting, scene=PlanningScene(CollisionConfig(), head, spheres))
        trajectories = [hold_guide_outside(one) for one in trajectories]
    left, right = (inverse(matrix_of(camera.camera_from_tool))[:3, 3] for camera in (scene.left, scene.right))
    fiducials = [fiducial.centre_ct_mm for fiducial in scene.head.fiducials]
    turned = choose_free_angles(setting, trajectories, fiducials, StereoSight(left, right))
    turned.check.require()
