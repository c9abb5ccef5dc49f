"""Two simulated arms in one room, as their calibration sees them.

In this process, without devices: the flanges are those of the simulator's true arms, the tracker has its bias
and noise, and every joint arrives from the same side.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.calibration.arm_errors import StatedArm
from procedures.calibration.base_to_base import BallFit, BallLooks, BaseToBase, bases_by_frames, refine_bases
from procedures.calibration.hand_eye import PosePairs
from procedures.strategies.strategy import ONE_SIDE
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibrated_arm.deviations import ArmDeviations
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED_MM, ErrorSizes
from ronna_hw.calibration import PoseRecord
from ronna_hw.errors import LimitError
from ronna_hw.vectors import JointVector
from sim.polaris.measurement.optics import Optics
from sim.polaris.unit.model import SPECTRA
from sim.theatre.records import CALIBRATED_ARM_ERROR_MM, STATED_ERROR_MM, arm_values, draw_mount_record
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import apply, inverse, matrix_from, matrix_of, rotation_towards
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import ArmResidual, ArmTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm, arm_seed

REGION_MM = np.array((640.0, -260.0, 430.0))  # between the arms, above the patient's side
SPREAD_MM = 60.0  # of the places in the region, either way along each axis
FRAMES = 60  # of the tracker, averaged per pose
FRAME_POSES, BALL_POSES = 40, 90
TILT_DEG, INSERTION_TILT_DEG = 25.0, 10.0  # of both arms, about each axis
MISSES = 60
SEEN_MM = 0.015  # one look at a ball by the stereo head, per axis
BALL_BESIDE_MM, BALL_ERROR_MM = np.array((0.02, -0.02, 0.02)), 0.03  # of its record, per axis
HEAD_UNKNOWN_MM = 2.0  # per axis: a mount as drawn
FORWARD = rotation_towards((1.0, 0.0, -1.0), (0.0, 0.0, -1.0))  # and down
DOWN = rotation_towards((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))


class SimulatedArm:
    """An arm with its truth and the model that the procedure has of it."""

    def __init__(self, truth: ArmTruth, seed: int, calibrated: bool) -> None:
        self.kinematics = find_arm(truth.variant).kinematics
        deviations = None
        if calibrated:
            values = arm_values(truth, ArmResidual(), noise(seed, "arm calibration", 1))
            deviations = ArmDeviations(**{name: np.array(value) for name, value in values.items()})
        self.model = CalibratedArm(self.kinematics, deviations)
        self._true = TrueArm(truth, seed)
        self._home = self.kinematics.home_rad
        self._motion = 0

    def joints_at(self, flange: Array) -> JointVector | None:
        """The joints that take the flange there by the nominal model, as at home; None out of reach."""
        pose, arm = Pose.from_matrix(flange.tolist()), self.kinematics
        try:
            return arm.solve_branch(pose, arm.branch_of(self._home), self._home)
        except LimitError:
            return None

    def truth(self, joints_rad: JointVector) -> Array:
        """The true flange at rest after another motion."""
        self._motion += 1
        return self._true.at_rest(joints_rad, ONE_SIDE, self._motion)

    def believed(self, joints_rad: JointVector) -> Array:
        """The flange by the model."""
        pose = self.model.flange_pose(joints_rad, ONE_SIDE)
        return pose.as_matrix()


class Flange(NamedTuple):
    """Poses (4, 4) of a flange in its base, as believed and in truth, and the joints there."""

    believed: Array
    true: Array
    rad: JointVector


class Pair(NamedTuple):
    """Flanges of master and assistant, and the ball (3,) mm where the head looks."""

    master: Flange
    assistant: Flange
    ball_mm: Array


class TwoArms:
    """Master and assistant of a random scene."""

    def __init__(self, seed: int, *, calibrated: bool) -> None:
        self.scene = scene = add_assistant(draw_scene("mini", seed=seed))
        assert scene.assistant is not None
        self._draws = np.random.default_rng([seed, 49])
        self.base = matrix_of(scene.assistant.robot_from_base)
        self.master = SimulatedArm(scene.arm, seed, calibrated)
        self.assistant = SimulatedArm(scene.assistant.arm, arm_seed(seed, ArmRole.ASSISTANT), calibrated)
        self._optics = Optics(scene.tracker, seed, SPECTRA.volumes)
        self._tracker = inverse(matrix_of(scene.tracker.robot_from_tracker))
        self._head_true = matrix_of(scene.mount.flange_from_tool_true)
        mount = scene.mount
        record: PoseRecord = mount.flange_from_tool_nominal
        self.head_error_mm = HEAD_UNKNOWN_MM
        if calibrated:
            record = draw_mount_record(mount, ArmResidual(), noise(seed, "arm calibration", 0))
            self.head_error_mm = ArmResidual().tool_mm
        self.head = matrix_of(record)
        share = CALIBRATED_ARM_ERROR_MM / UNCALIBRATED_MM if calibrated else 1.0
        self._sizes = ErrorSizes(self.head_error_mm, share, share, share)
        self._ball = np.array(scene.assistant.flange_from_ball_mm)

    def by_frames(self) -> BaseToBase:
        """Bases by what the tracker sees of both frames."""
        scene = self.scene
        assert scene.assistant is not None
        on_master = self._head_true @ matrix_of(scene.mount.tool_from_marker_true)
        on_assistant = matrix_of(scene.assistant.flange_from_frame)
        markers = {tool.name: np.array(tool.markers_mm) for tool in scene.tracker.tools}
        return bases_by_frames(
            self._frame_pairs(self.master, np.eye(4), on_master, markers["robot_frame"]),
            self._frame_pairs(self.assistant, self.base, on_assistant, markers["assistant_frame"]),
            (STATED_ERROR_MM, STATED_ERROR_MM),
        ).bases

    def by_ball(self, coarse: BaseToBase) -> BallFit:
        """Bases refined by looks at the ball."""
        return refine_bases(coarse, self.ball_looks(), *self.stated)

    @property
    def stated(self) -> tuple[Array, float, StatedArm, StatedArm]:
        """Ball and arms as their records state them."""
        master, assistant = (
            StatedArm(one.kinematics.chain, self._sizes) for one in (self.master, self.assistant)
        )
        return self._ball + BALL_BESIDE_MM, BALL_ERROR_MM, master, assistant

    def ball_looks(self) -> BallLooks:
        """Looks at the ball in postures spread over the region."""
        rows = []
        for _ in range(BALL_POSES):
            master, assistant, ball = self._together(TILT_DEG)
            in_head = apply(inverse(master.true @ self._head_true), ball)
            seen_mm = in_head + self._draws.normal(0.0, SEEN_MM, 3)
            rows.append((master.believed @ self.head, seen_mm, assistant.believed, master.rad, assistant.rad))
        return BallLooks(*map(np.array, zip(*rows, strict=True)))

    def coarse_misses(self, bases: BaseToBase, count: int = MISSES) -> Array:
        """Misses (n, 3) mm of two tools in new postures, each known exactly on its flange."""
        return np.array(
            [
                self._miss_mm(pair, bases.robot_from_base, self._head_true, self._ball)
                for pair in (self._together(INSERTION_TILT_DEG) for _ in range(count))
            ]
        )

    def fine_misses(self, fit: BallFit, count: int = MISSES) -> Array:
        """Misses (n, 3) mm of ball and head in new postures, less what the fit predicts."""
        base, found = fit.bases.robot_from_base, []
        for _ in range(count):
            pair = self._together(INSERTION_TILT_DEG)
            master, assistant, _ = pair
            head_mm = (master.believed @ self.head)[:3, 3]
            ball_mm = apply(assistant.believed, fit.flange_from_ball_mm)
            by_master, by_assistant = (
                arm.stated.displacements([at.rad], [place_mm], ONE_SIDE)[0] @ np.array(arm.errors)
                for arm, at, place_mm in ((fit.master, master, head_mm), (fit.assistant, assistant, ball_mm))
            )
            predicted_mm = base[:3, :3] @ by_assistant - by_master
            found.append(self._miss_mm(pair, base, self.head, fit.flange_from_ball_mm) - predicted_mm)
        return np.array(found)

    def _miss_mm(self, pair: Pair, base: Array, head: Array, ball_mm: Array) -> Array:
        """Error (3,) mm of where both models have the ball beside the tool centre of the head."""
        master, assistant, ball = pair
        believed_mm = apply(base @ assistant.believed, ball_mm) - (master.believed @ head)[:3, 3]
        return np.asarray(ball - (master.true @ self._head_true)[:3, 3] - believed_mm)

    def _together(self, tilt_deg: float) -> Pair:
        """Flanges of both arms, with ball and tool centre in one place."""

        def flange() -> Array:
            place = self._place()
            turned = self.base[:3, :3] @ FORWARD @ self._turned(tilt_deg)
            return matrix_from(place - turned @ self._ball, turned)

        at_assistant = self._reach(self.assistant, flange, self.base)
        ball = apply(self.base @ at_assistant.true, self._ball)

        def head() -> Array:
            return matrix_from(ball, DOWN @ self._turned(tilt_deg)) @ inverse(self._head_true)

        return Pair(self._reach(self.master, head, np.eye(4)), at_assistant, ball)

    def _reach(self, arm: SimulatedArm, wanted: Callable[[], Array], base: Array) -> Flange:
        """The flange in its base at the first pose within reach."""
        for _ in range(200):
            joints = arm.joints_at(inverse(base) @ wanted())
            if joints is not None:
                return Flange(arm.believed(joints), arm.truth(joints), joints)
        raise AssertionError("nothing in reach")

    def _frame_pairs(self, arm: SimulatedArm, base: Array, on_flange: Array, markers_mm: Array) -> PosePairs:
        flanges, seen = [], []
        facing = DOWN if arm is self.master else base[:3, :3] @ DOWN
        for _ in range(FRAME_POSES):

            def flange() -> Array:
                place = self._place()
                turned = facing @ self._turned(35.0)
                return matrix_from(place - turned @ on_flange[:3, 3], turned)

            believed, true, _ = self._reach(arm, flange, base)
            places = apply(self._tracker @ base @ true @ on_flange, markers_mm)
            sight = self._optics.sight(places)
            measured = sight.measured(self._draws.normal(size=places.shape) / np.sqrt(FRAMES))
            flanges.append(believed)
            seen.append(_fitted(markers_mm, measured))
        return PosePairs(np.array(flanges), np.array(seen))

    def _place(self) -> Array:
        return np.asarray(REGION_MM + self._draws.uniform(-SPREAD_MM, SPREAD_MM, 3))

    def _turned(self, tilt_deg: float) -> Array:
        vector = np.radians(self._draws.uniform(-tilt_deg, tilt_deg, 3)) * (1.0, 1.0, 1.5)
        return np.asarray(Rotation.from_rotvec(vector).as_matrix())


@cache
def two_arms(seed: int, *, calibrated: bool) -> tuple[TwoArms, BaseToBase, BallFit]:
    """The arms of a scene with both calibrations of their bases."""
    arms = TwoArms(seed, calibrated=calibrated)
    coarse = arms.by_frames()
    return arms, coarse, arms.by_ball(coarse)


def _fitted(model_mm: Array, places_mm: Array) -> Array:
    """The pose (4, 4) that takes markers (n, 3) to their places best."""
    middle, centre = model_mm.mean(axis=0), places_mm.mean(axis=0)
    turn, _ = Rotation.align_vectors(places_mm - centre, model_mm - middle)
    rotation = np.asarray(turn.as_matrix())
    return matrix_from(centre - rotation @ middle, rotation)
