"""An arm as `ronna-arm calibrate` identifies it, and the target errors of strategies that use the result.

Measures the phantom's own spheres with the simulator's true arm, the procedure's choice of poses and its
identification, all in this process: without protocols or images. The controller then uses the identified arm
in place of the true one, including the side of its backlash on which each joint rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_calibration import ArmFit, identify
from procedures.calibration.arm_model import ArmModel, LookArrays, choose_poses
from procedures.calibration.pose_set import centred_looks
from procedures.registration.rigid_fit import fit_rigid
from procedures.steps.calibration.sphere_looks import CANDIDATES, flanks_of
from ronna_hw.arm.deviations import ArmDeviations, flange_poses
from ronna_hw.arm.pose import Pose
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform
from sim.world.arm.true_arm import TrueArm
from studies.accuracy.postures import ARM, TOOL, TOOL_MM, Postures
from studies.accuracy.random_arms import RandomArms, drawn_arm
from studies.accuracy.scene import Scene
from studies.accuracy.solving import solved
from studies.accuracy.trials import AXES, Sizes

Array = NDArray[np.float64]

LOOKS = 90  # the default of `ronna-arm calibrate`
STEREO_MM = 0.005  # of a measurement, per axis
LOOKS_KEY = 9  # of the random numbers


def identified(seed: int, number: int, spheres_mm: Array) -> ArmFit:
    """Arm `number` identified from measurements of spheres (n, 3) mm, robot frame. Raises
    CAL-002 to CAL-004.
    """
    truth, tool_error_mm = drawn_arm(seed, number)
    arm, generator = TrueArm(truth, number), np.random.default_rng([seed, LOOKS_KEY, number])
    model = ArmModel(ARM, TOOL)
    candidates = _candidates(spheres_mm)
    chosen = np.zeros(len(candidates.joints_rad), dtype=bool)
    chosen[choose_poses(model, candidates, LOOKS)] = True
    looks = candidates.only(chosen)
    for row, (joints, flanks) in enumerate(zip(looks.joints_rad, looks.flanks, strict=True)):
        flange = arm.at_rest(joints, flanks, row)
        away = spheres_mm[looks.sphere[row]] - flange[:3, 3]
        looks.points_mm[row] = flange[:3, :3].T @ away - TOOL_MM - tool_error_mm
    looks.points_mm[:] += generator.normal(0.0, STEREO_MM, looks.points_mm.shape)
    return identify(model, looks)


def _candidates(spheres_mm: Array) -> LookArrays:
    """Measurement poses that the nominal arm reaches, not yet taken."""
    reference, branch = ARM.flange_pose(ARM.home_rad).rigid.rotation, ARM.branch_of(ARM.home_rad)
    found = []
    for number, sphere in enumerate(spheres_mm):
        for order, look in enumerate(centred_looks(reference, sphere, CANDIDATES)):
            try:
                joints = ARM.solve_branch(
                    Pose.from_transform(look.pose @ TOOL.inverse()), branch, ARM.home_rad
                )
            except LimitError:
                continue
            found.append((number, joints, flanks_of(order)))
    return LookArrays(
        joints_rad=np.array([joints for _, joints, _ in found]),
        flanks=np.array([flanks for _, _, flanks in found], dtype=float),
        points_mm=np.zeros((len(found), AXES)),
        covariances_mm2=np.tile(STEREO_MM**2 * np.eye(AXES), (len(found), 1, 1)),
        sphere=np.array([number for number, _, _ in found], dtype=np.intp),
    )


@dataclass(frozen=True)
class BelievedArm:
    """The arm model that the controller uses."""

    deviations: ArmDeviations
    flange_from_tool: Transform

    def tool(self, joints_rad: Array, flanks: Array) -> tuple[Array, Array]:
        """Positions (p, 3) mm and orientations (p, 3, 3) of the tool, robot frame, at joints (p, 6)."""
        poses = flange_poses(ARM.chain, self.deviations, joints_rad, flanks)
        turned = poses[:, :3, :3]
        places = turned @ self.flange_from_tool.translation_mm + poses[:, :3, 3]
        return places, turned @ self.flange_from_tool.rotation_matrix


def identified_errors(
    arm: RandomArms,
    believed: BelievedArm,
    planned: Postures,
    scene: Scene,
    numbers: Sequence[int],
    sizes: Sizes,
) -> Array:
    """Error vectors (t, c, 3) mm of one arm, like `target_errors` for many; `numbers` is its own."""
    phantom, robot_from_ct, chance = scene.phantom, scene.robot_from_ct, scene.chance(numbers)
    spheres, sets = robot_from_ct.apply(phantom.spheres_mm), planned.sets
    targets_ct = np.array([one.target_mm for one in phantom.trajectories])

    def true_places(joints: Array, flanks: Array) -> Array:
        return np.asarray(arm.tool_points_mm(joints[None], flanks[None])[0])

    _, seen = solved(
        planned.localizations,
        lambda joints: believed.tool(joints, planned.arrival),
        lambda joints, _: np.tile(spheres, (sets, 1)) - true_places(joints, planned.arrival),
        planned.localizations.joints_rad.shape,
    )
    recorded = seen.reshape(sets, len(spheres), AXES)
    recorded = recorded + sizes.servo_mm / np.sqrt(AXES) * chance.servo[0, :sets]
    recorded = recorded + arm.repeatability_mm * chance.rest[0, :sets]
    image = phantom.spheres_mm + sizes.ct_mm / np.sqrt(AXES) * chance.ct[0]
    serving = [planned.set_of(target) for target in range(len(targets_ct))]
    found = []
    for count in scene.counts:
        fit = fit_rigid(image[None, :count], recorded[:, :count])
        places = np.einsum("tij,tj->ti", fit.rotation[serving], targets_ct) + fit.translation_mm[serving]
        joints = _at_targets(believed, planned, places)
        tips = true_places(joints, planned.target_arrival) + arm.repeatability_mm * chance.target_rest[0]
        found.append(tips - robot_from_ct.apply(targets_ct))
    return np.stack(found, axis=1)


def _at_targets(believed: BelievedArm, planned: Postures, places_mm: Array) -> Array:
    """Joints (t, 6) that the controller commands to have its tool at these places."""
    joints, _ = solved(
        planned.targets,
        lambda joints: believed.tool(joints, planned.target_arrival),
        lambda _, at: places_mm - at,
        planned.targets.joints_rad.shape,
    )
    return joints
