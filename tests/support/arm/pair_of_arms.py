"""Pairs of random motions of two arms, and their distance by truth.

The truth shares nothing with the checks: bodies ride on the simulator's Pinocchio chains, with the errors of
its arms, from the true base; distances are those of densely sampled axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.clearance.arm_pair import ArmPairWorld, PlacedArm, SampledPath
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Part, Surroundings
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm.pose import Pose
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.errors import LimitError
from ronna_hw.vectors import JointVector, joint_vector
from sim.world.descriptions import DESCRIPTIONS
from sim.world.rigid import Matrix, apply, matrix_from, matrix_of, rotation_from_vector
from sim.world.scene.as_built import draw_arm
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import ArmTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import build_model

Array = NDArray[np.float64]

CYCLE_S = 0.02  # coarser than an arm's own: bounds hold between postures, and the truth is sampled
LAG_S = 0.5
SPREAD_DEG = (30.0, 25.0, 25.0, 60.0, 50.0, 100.0)  # about home with the arm reaching out, either way
REACHING_DEG = (0.0, 25.0, -20.0, 0.0, 0.0, 0.0)  # from home: into the room of the other arm
POINTS = 33  # on each axis of the truth
CELL = CollisionConfig()
HEAD = Pose.from_kuka(760.0, 0.0, 200.0, 90.0, 0.0, 30.0)
TOOL_OF_MASTER = Pose((220.0, 0.0, 60.0))
HOLDER = Part("holder", Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 150.0), 15.0))
BASE_ERROR_MM, BASE_ERROR_RAD = 0.2, 2e-4  # of the calibration by tracker frames, per axis


@dataclass(frozen=True)
class TrueBodies:
    """Bodies of an arm on its true chain, from its true base."""

    arm: PlacedArm
    truth: ArmTruth
    base: Matrix

    def axes(self, joints_rad: Array) -> Array:
        """Axis ends of all bodies in the robot frame, (n, bodies, 2, 3)."""
        model, flange = build_model(DESCRIPTIONS[self.truth.variant], self.truth.links)
        data = model.createData()
        bodies = self.arm.bodies
        offsets = _frame_offsets(bodies.arm, self.truth.variant)
        column = bodies.fixed[0]
        found = []
        for joints in np.asarray(joints_rad) + np.array(self.truth.joint_offset_rad):
            pin.framesForwardKinematics(model, data, joints)
            ends = [(column.start_mm, column.end_mm)]
            for link in bodies.arm.links:
                frame = data.oMi[link.joint + 1].homogeneous
                ends.append(
                    [apply(frame, np.add(end, offsets[link.joint])) for end in (link.start_mm, link.end_mm)]
                )
            at_flange = data.oMf[flange].homogeneous
            ends += [[apply(at_flange, end) for end in part.capsule[:2]] for part in bodies.surroundings.tool]
            found.append(ends)
        return apply(self.base, np.array(found, dtype=float).reshape(-1, 3)).reshape(len(found), -1, 2, 3)


def _frame_offsets(arm: Kinematics, variant: str) -> list[Array]:
    """Origin of each joint in our description minus that in the simulator's, both arms at zero."""
    model, _ = build_model(DESCRIPTIONS[variant], None)
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(6))
    place, offsets = np.array(arm.chain.base_mm, dtype=float), []
    for number, joint in enumerate(arm.chain.joints):
        offsets.append(place - data.oMi[number + 1].translation)
        place = place + np.array(joint.to_next_mm)
    return offsets


def true_gaps_mm(first: Array, second: Array, first_radii: Array, second_radii: Array) -> Array:
    """Smallest surface distance (n) of bodies with axes (n, a, 2, 3) and (n, b, 2, 3), by brute force.

    Points of one axis against the whole other axis: at most a hundredth too large, and never too small.
    """
    shares = np.linspace(0.0, 1.0, POINTS)[:, None]
    points = first[:, :, None, 0] * (1.0 - shares) + first[:, :, None, 1] * shares  # (n, a, points, 3)
    least = np.full(len(first), np.inf)
    for number, radius in enumerate(second_radii):
        start, along = second[:, number, 0][:, None, None], (second[:, number, 1] - second[:, number, 0])
        along = along[:, None, None]
        square = np.maximum((along * along).sum(-1), 1e-9)
        share = np.clip(((points - start) * along).sum(-1) / square, 0.0, 1.0)
        apart = np.linalg.norm(points - start - share[..., None] * along, axis=-1).min(axis=2)
        least = np.minimum(least, (apart - first_radii - radius).min(axis=1))
    return least


class PairOfArms:
    """Two arms of a random scene, as calibrated and in truth."""

    def __init__(self, seed: int, assistant: str = "kr6_r900_sixx") -> None:
        self.draws = np.random.default_rng([seed, 30])
        scene = add_assistant(draw_scene("mini", seed=seed))
        assert scene.assistant is not None
        base = matrix_of(scene.assistant.robot_from_base)
        error = matrix_from(
            self.draws.normal(0.0, BASE_ERROR_MM, 3),
            rotation_from_vector(self.draws.normal(0.0, BASE_ERROR_RAD, 3)),
        )
        master_arm, other_arm = find_arm(scene.arm.variant).kinematics, find_arm(assistant).kinematics
        around = CELL.build_surroundings(
            CELL.stereo_head,
            TOOL_OF_MASTER,
            Pose.from_kuka(760.0, 0.0, 200.0, 90.0, 0.0, 30.0),
            (75.0, 95.0, 90.0),
        )
        self.master = PlacedArm("master", Bodies(master_arm, around), Pose((0.0, 0.0, 0.0)))
        holder = Surroundings(tool=(HOLDER,))
        self.assistant = PlacedArm(
            "assistant", Bodies(other_arm, holder), Pose.from_matrix((base @ error).tolist())
        )
        truth = draw_arm(self.draws).model_copy(update={"variant": assistant})
        self.true_master = TrueBodies(self.master, scene.arm, np.eye(4))
        self.true_assistant = TrueBodies(self.assistant, truth, base)
        self.world = ArmPairWorld(self.master, self.assistant)

    def sampled_path(self, arm: PlacedArm) -> SampledPath:
        """A random joint move of an arm."""
        kinematics = find_arm(arm.bodies.arm.name).kinematics  # type: ignore[attr-defined]
        while True:
            start, goal = self.posture(kinematics), self.posture(kinematics)
            try:
                plan = plan_joint_move(kinematics, start, goal, working_limits(kinematics))
            except LimitError:
                continue
            return SampledPath.driven(arm, kinematics, plan, CYCLE_S)

    def posture(self, kinematics: Kinematics) -> JointVector:
        """A random posture about home."""
        spread = np.radians(REACHING_DEG) + np.radians(SPREAD_DEG) * self.draws.uniform(-1.0, 1.0, 6)
        return joint_vector((np.array(kinematics.home_rad) + spread).tolist())

    def least_true_gap_mm(self, first: SampledPath, second: SampledPath, lag_s: float) -> float:
        """Smallest distance by truth, when the second arm lags the first by `lag_s`."""
        count = max(first.count, second.count)
        lag = round(lag_s / CYCLE_S)
        rows = np.arange(-abs(lag), count + abs(lag))
        one = first.joints_rad[np.clip(rows, 0, first.count - 1)]
        other = second.joints_rad[np.clip(rows - lag, 0, second.count - 1)]
        return float(
            true_gaps_mm(
                self.true_master.axes(one),
                self.true_assistant.axes(other),
                np.array(self.master.radii_mm),
                np.array(self.assistant.radii_mm),
            ).min()
        )
