"""Two simulated arms in one room, as their calibration sees them.

In this process, without devices: the flanges are those of the simulator's true arms, the tracker has its bias
and noise, and every joint arrives from the same side.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.base_to_base import BallFit, BallLooks, BaseToBase, bases_by_frames, refine_bases
from procedures.calibration.hand_eye import PosePairs
from ronna_hw.arm.catalogue import find_kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.calibrated_arm.deviations import ArmDeviations, CalibratedArm
from ronna_hw.calibration import PoseRecord
from ronna_hw.errors import LimitError
from ronna_hw.vectors import JointVector
from sim.polaris.measurement.optics import Optics
from sim.polaris.unit.model import SPECTRA
from sim.theatre.records import STATED_ERROR_MM, arm_values, draw_mount_record
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import apply, inverse, matrix_from, matrix_of, rotation_towards
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import ArmResidual, ArmTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm, arm_seed

Array = NDArray[np.float64]

REGION_MM = np.array((640.0, -260.0, 430.0))  # between the arms, above the patient's side
SPREAD_MM = 60.0  # of the places in the region, either way along each axis
FRAMES = 60  # of the tracker, averaged per pose
FRAME_POSES, BALL_POSES = 40, 90
TILT_DEG, INSERTION_TILT_DEG = 25.0, 10.0  # of both arms, about each axis
MISSES = 60
SEEN_MM = 0.015  # one look at a ball by the stereo head, per axis
ONE_SIDE = (1.0,) * 6
HEAD_UNKNOWN_MM = 2.0  # per axis: a mount as drawn
FORWARD = rotation_towards((1.0, 0.0, -1.0), (0.0, 0.0, -1.0))  # and down
DOWN = rotation_towards((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))


class SimulatedArm:
    """An arm with its truth and the model that the procedure has of it."""

    def __init__(self, truth: ArmTruth, seed: int, calibrated: bool) -> None:
        self.kinematics = find_kinematics(truth.variant)
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
        return refine_bases(coarse, self.ball_looks(), (0.0, 0.0, 160.0), self.head_error_mm)

    def ball_looks(self) -> BallLooks:
        """Looks at the ball in postures spread over the region."""
        heads, flanges, seen = [], [], []
        for _ in range(BALL_POSES):
            master, assistant, ball = self._together(TILT_DEG)
            heads.append(master[0] @ self.head)
            flanges.append(assistant[0])
            in_head = apply(inverse(master[1] @ self._head_true), ball)
            seen.append(in_head + self._draws.normal(0.0, SEEN_MM, 3))
        return BallLooks(np.array(heads), np.array(seen), np.array(flanges))

    def coarse_misses(self, bases: BaseToBase, count: int = MISSES) -> Array:
        """Misses (n, 3) mm of two tools in new postures, each known exactly on its flange."""
        return self._misses(bases.robot_from_base, self._ball, self._head_true, count)

    def fine_misses(self, fit: BallFit, count: int = MISSES) -> Array:
        """The same for tools that are known relative to the ball and to the head as fitted."""
        head = self.head @ matrix_from(fit.head_shift_mm, np.eye(3))
        return self._misses(fit.bases.robot_from_base, fit.flange_from_ball_mm, head, count)

    def _misses(self, bases: Array, ball_mm: Array, head: Array, count: int) -> Array:
        found = []
        for _ in range(count):
            at_master, at_assistant, ball = self._together(INSERTION_TILT_DEG)
            believed_apart = apply(bases @ at_assistant[0], ball_mm) - (at_master[0] @ head)[:3, 3]
            found.append(ball - (at_master[1] @ self._head_true)[:3, 3] - believed_apart)
        return np.array(found)

    def _together(self, tilt_deg: float) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
        """Flanges of both arms, each as believed and in truth, with ball and tool centre in one place."""

        def flange() -> Array:
            place = self._place()
            turned = self.base[:3, :3] @ FORWARD @ self._turned(tilt_deg)
            return matrix_from(place - turned @ self._ball, turned)

        at_assistant = self._reach(self.assistant, flange, self.base)
        ball = apply(self.base @ at_assistant[1], self._ball)

        def head() -> Array:
            return matrix_from(ball, DOWN @ self._turned(tilt_deg)) @ inverse(self._head_true)

        at_master = self._reach(self.master, head, np.eye(4))
        return at_master, at_assistant, ball

    def _reach(self, arm: SimulatedArm, wanted: Callable[[], Array], base: Array) -> tuple[Array, Array]:
        """The flange in its base as believed and in truth, at the first pose within reach."""
        for _ in range(200):
            joints = arm.joints_at(inverse(base) @ wanted())
            if joints is not None:
                return arm.believed(joints), arm.truth(joints)
        raise AssertionError("nothing in reach")

    def _frame_pairs(self, arm: SimulatedArm, base: Array, on_flange: Array, markers_mm: Array) -> PosePairs:
        flanges, seen = [], []
        facing = DOWN if arm is self.master else base[:3, :3] @ DOWN
        for _ in range(FRAME_POSES):

            def flange() -> Array:
                place = self._place()
                turned = facing @ self._turned(35.0)
                return matrix_from(place - turned @ on_flange[:3, 3], turned)

            believed, true = self._reach(arm, flange, base)
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
