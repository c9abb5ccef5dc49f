"""Two arms in one collision world: distances agree, and planned paths keep the margin by truth.

The truth shares nothing with the checks: bodies ride on the simulator's Pinocchio chains, with the errors of
its arms, from the true base; distances are those of densely sampled axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from procedures.workcell.placed_arms import PlacedArms
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.clearance.arm_pair import APART_MM, PlacedArm
from ronna_hw.arm.clearance.arm_pair_world import ArmPairWorld
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Part, Surroundings, segment_distance_mm
from ronna_hw.arm.clearance.live_pair import LivePair
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move
from ronna_hw.arm.motion.progress import drive_states
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.errors import LimitError
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.vectors import JointVector, joint_vector
from sim.world.descriptions import DESCRIPTIONS
from sim.world.rigid import Matrix, apply, matrix_from, matrix_of, rotation_from_vector
from sim.world.scene.as_built import draw_arm
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import ArmTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import build_model

CYCLE_S = 0.02  # coarser than an arm's own: the truth is sampled
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

    @property
    def arms(self) -> tuple[PlacedArm, PlacedArm]:
        """Both arms as calibrated, the master first."""
        return self.master, self.assistant

    def plan(self, kinematics: Kinematics) -> MotionPlan:
        """A random joint move of an arm."""
        while True:
            start, goal = self.posture(kinematics), self.posture(kinematics)
            try:
                return plan_joint_move(kinematics, start, goal, working_limits(kinematics))
            except LimitError:
                continue

    def posture(self, kinematics: Kinematics) -> JointVector:
        """A random posture about home."""
        spread = np.radians(REACHING_DEG) + np.radians(SPREAD_DEG) * self.draws.uniform(-1.0, 1.0, 6)
        return joint_vector((np.array(kinematics.home_rad) + spread).tolist())

    def least_true_gap_mm(self, moving: int, path_rad: Array, resting_rad: JointVector) -> float:
        """Smallest distance by truth while one arm, 0 or 1, moves and the other rests."""
        arms = (self.true_master, self.true_assistant)
        one, other = arms[moving], arms[1 - moving]
        rests = np.broadcast_to(
            other.axes(np.array([resting_rad])), (len(path_rad), len(other.arm.names), 2, 3)
        )
        radii = [np.array(arm.arm.radii_mm) for arm in (one, other)]
        return float(true_gaps_mm(one.axes(path_rad), rests, *radii).min())


ARMS = ("kr6_r900_sixx", "ur5e")


@pytest.mark.parametrize("assistant", ARMS)
def test_the_live_distance_is_the_planned_one(assistant: str) -> None:
    pair = PairOfArms(1, assistant)
    live = LivePair(pair.master, pair.assistant)
    for _ in range(40):
        postures = [pair.posture(arm.bodies.arm) for arm in (pair.master, pair.assistant)]
        planned = pair.world.distance(*postures)
        if planned.distance_mm > 0.0:  # overlaps are only compared by their sign
            assert live.distance(*postures).distance_mm == pytest.approx(planned.distance_mm, abs=1e-3)
        else:
            assert live.distance(*postures).distance_mm < 1e-3


def test_the_watch_finds_every_approach_although_it_does_not_measure_every_time() -> None:
    pair = PairOfArms(4)
    live, measured = LivePair(pair.master, pair.assistant), LivePair(pair.master, pair.assistant)
    here, there = ([pair.posture(arm.bodies.arm) for arm in (pair.master, pair.assistant)] for _ in range(2))
    limit_mm = 300.0
    for share in np.linspace(0.0, 1.0, 200):
        now = [
            tuple(np.add(np.multiply(a, 1.0 - share), np.multiply(b, share)))
            for a, b in zip(here, there, strict=True)
        ]
        near = live.find_near(*now, limit_mm)
        assert (near is not None) == (measured.distance(*now).distance_mm < limit_mm)


def test_an_arm_at_rest_is_as_far_from_the_other_as_the_obstacles_made_of_it() -> None:
    pair = PairOfArms(2)
    moving, resting = (pair.posture(arm.bodies.arm) for arm in (pair.master, pair.assistant))
    obstacles = pair.assistant.as_obstacles(resting, pair.master.base, 12.0)
    axes, radii = pair.master.axes(np.array([moving]))[0], pair.master.radii_mm
    nearest = min(
        segment_distance_mm(tuple(a), tuple(b), *body.capsule[:2]) - radius - body.capsule.radius_mm
        for (a, b), radius in zip(axes.tolist(), radii, strict=True)
        for body in obstacles
    )
    assert nearest == pytest.approx(pair.world.distance(moving, resting).distance_mm - 12.0, abs=1e-3)


def driven_rad(kinematics: Kinematics, plan: MotionPlan) -> Array:
    """Joints along a planned motion, one row per cycle."""
    path, joints = plan.path(kinematics), [plan.start_rad]
    for state in drive_states(plan.limits, plan.speed_steps, CYCLE_S):
        joints.append(path.joints(min(max(state.position[0], 0.0), 1.0), joints[-1]))
    return np.array(joints)


def allowed_gaps_mm(pairs: int, scenes: int) -> list[float]:
    """The smallest true distances of random motions beside a resting arm that are allowed."""
    gaps = []
    for number in range(pairs):
        pair = PAIRS.setdefault(number % scenes, PairOfArms(number % scenes, ARMS[number % scenes % 2]))
        chains = dict(
            zip(ROLES, (find_arm(arm.bodies.arm.name).kinematics for arm in pair.arms), strict=True)
        )
        moving = int(pair.draws.integers(2))
        role, other = ROLES[moving], ROLES[1 - moving]
        plan, resting_rad = pair.plan(chains[role]), pair.posture(chains[other])
        placed = PlacedArms(ROLES, chains.__getitem__)
        placed.around.update(zip(ROLES, (arm.bodies.surroundings for arm in pair.arms), strict=True))
        placed.place(ASSISTANT, pair.assistant.base, 0.0)
        if not placed.are_apart({role: plan.start_rad, other: resting_rad}):
            continue
        around = placed.surroundings_among(role, {other: resting_rad})
        if sweep_path(chains[role], plan, around, search_closest=False).refused is None:
            gaps.append(pair.least_true_gap_mm(moving, driven_rad(chains[role], plan), resting_rad))
    return gaps


ROLES = (MASTER, ASSISTANT)
PAIRS: dict[int, PairOfArms] = {}


@pytest.mark.parametrize(
    ("pairs", "scenes"),
    [(12, 2), pytest.param(10_000, 50, marks=(pytest.mark.soak, pytest.mark.timeout(3600)))],
)
def test_allowed_motions_keep_their_distance_by_truth(pairs: int, scenes: int) -> None:
    gaps_mm = allowed_gaps_mm(pairs, scenes)
    assert len(gaps_mm) >= pairs // 3
    assert min(gaps_mm) >= APART_MM
