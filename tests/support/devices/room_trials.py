"""Readings of the tracker over a case, in this process: the scene's true arm, bias and noise.

A case visits poses in order. At each the tracker reads the frame on the arm and the patient's spheres,
averaged over as many frames as the steps take. Spheres count as visible everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from remembering_arm import RememberingArm
from room_looks import room_reading_of, seen_frame

from benchmarks.stereo_head.head_looks import ENDPOINTS
from procedures.guards.room_reading import FRAMES, RoomReading
from procedures.guards.room_watch import RoomWatch
from procedures.steps.clinical.localized_room import LocalizedRoom
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.strategy import ArmInBranch
from procedures.strategies.trajectory import Trajectory, back_along_axis, target_pose
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.config import Calibrations, parse_theatre
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from sim.polaris.measurement.optics import Optics
from sim.polaris.measurement.tracking_rules import fit_rigid_body
from sim.polaris.unit.model import SPECTRA
from sim.theatre.theatre_file import theatre_content
from sim.world.rigid import apply, inverse, matrix_from, matrix_of
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.parts import GUIDE_FRAME_IN_TIP, GUIDE_FRAME_MARKERS_MM
from sim.world.true_arm import TrueArm

APPROACH_MM = 60.0
FLANKS = (1.0,) * 6
STILL = np.zeros(3)
IN_PLACE = np.eye(4)
GLOBAL_FRAMES = 60


@dataclass(frozen=True)
class Visit:
    """Joints over every sphere in the orientation of one target, over that target, and at it."""

    target: str
    over_spheres: tuple[JointVector, ...]
    standoff: JointVector
    at: JointVector


@dataclass
class TrackedCase:
    """One scene: the poses that a case rests in, and what the tracker reads there."""

    seed: int
    generator: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.scene = draw_scene("default", seed=self.seed)
        self.generator = np.random.default_rng([self.seed, 26])
        truth = self.scene
        self.kinematics = kr6_r900(truth.arm.variant)
        self._arm = TrueArm(truth.arm, self.seed)
        self._optics = Optics(truth.tracker, self.seed, SPECTRA.volumes)
        self.tracker_from_robot = inverse(matrix_of(truth.tracker.robot_from_tracker))
        self.flange_from_marker = matrix_of(truth.mount.flange_from_tool_true) @ matrix_of(
            truth.mount.tool_from_marker_true
        )
        self.body_mm = np.array(truth.tracker.tools[0].markers_mm)
        robot_from_ct = matrix_of(truth.head.robot_from_ct)
        self.spheres_mm = apply(robot_from_ct, [each.centre_ct_mm for each in truth.head.fiducials])
        theatre = parse_theatre(theatre_content(truth, ENDPOINTS, "host:", {}, 1.0))
        assert theatre.calibration is not None
        self.records: Calibrations = theatre.calibration
        self._poses: dict[JointVector, tuple[Transform, Array]] = {}  # nominal and true flange

    @cached_property
    def home_rad(self) -> JointVector:
        a, b, c, d, e, f = (math.radians(angle) for angle in self.scene.arm.home_deg)
        return (a, b, c, d, e, f)

    @cached_property
    def visits(self) -> list[Visit]:
        """The poses for each target within reach: over every sphere, over the target and at it."""
        strategy = find_strategy("ocs")
        tool = self.scene.mount.flange_from_tool_nominal.transform(Frame.FLANGE, Frame.TOOL)
        branch = self.kinematics.branch_of(self.home_rad)
        arm = ArmInBranch(self.kinematics, tool, tool, branch, self.home_rad)
        head = self.scene.head
        robot_from_ct = head.robot_from_ct.transform(Frame.ROBOT, Frame.CT)
        centres = np.array([each.centre_ct_mm for each in head.fiducials])
        found = []
        for target in head.targets:
            one = Trajectory(
                target.identifier, np.array(target.entry_ct_mm), np.array(target.target_ct_mm),
                math.radians(target.free_angle_deg),
            )  # fmt: skip
            goal = target_pose(one, robot_from_ct)
            try:
                over = tuple(
                    self._joints(back_along_axis(sphere, APPROACH_MM))
                    for sphere in strategy.localization_poses(one, centres, robot_from_ct, arm)
                )
                standoff = self._joints(back_along_axis(goal, one.depth_mm + APPROACH_MM))
                at = self._joints(goal)
            except RonnaError:
                continue
            found.append(Visit(target.identifier, over, standoff, at))
        return found

    @cached_property
    def rests(self) -> list[JointVector]:
        """Home, over the last sphere of each trajectory, home, then over and at each target."""
        targeting = [place for one in self.visits for place in (one.standoff, one.at, one.standoff)]
        return [self.home_rad, *(one.over_spheres[-1] for one in self.visits), self.home_rad, *targeting]

    def begin(self) -> RoomWatch:
        """The watch after a global localization at home."""
        spheres, frame = self._seen(self._at(self.home_rad)[1], IN_PLACE, IN_PLACE, GLOBAL_FRAMES)
        flange = self.kinematics.flange_pose(self.home_rad)
        robot_from_tracker = self.frame_by_arm(flange) @ frame.inverse()
        room = LocalizedRoom(robot_from_tracker, spheres, self.home_rad, self.body_mm, GLOBAL_FRAMES)
        watch = room.watch("trial", self._tracked_arm, self._flange_pose)
        robot_from_ct = matrix_of(self.scene.head.robot_from_ct)
        watch.points_mm = {
            one.identifier: apply(robot_from_ct, [one.target_ct_mm])[0] for one in self.scene.head.targets
        }
        return watch

    @cached_property
    def _tracked_arm(self) -> RememberingArm:
        flange = self.kinematics.flange_pose(self.home_rad)
        mount = flange.inverse() @ self.frame_by_arm(flange)
        repeatable_mm = find_arm(self.kinematics.name).repeatability_mm
        return RememberingArm(self.kinematics.chain, ErrorSizes(), mount.as_matrix(), repeatable_mm)

    def _flange_pose(self, joints: JointVector, _sides: Sequence[int] | None) -> Transform:
        return self.kinematics.flange_pose(joints)

    def reading(
        self, watch: RoomWatch, joints: JointVector, head_mm: Array = STILL, cart_mm: Array = STILL
    ) -> RoomReading:
        """What the tracker reads with head and cart moved so far, in the robot's first axes."""
        head, cart = (matrix_from(way_mm, np.eye(3)) for way_mm in (head_mm, cart_mm))
        return self.read(watch, joints, self._at(joints)[1], FRAMES, head=head, cart=cart, sides=FLANKS)

    def read(
        self,
        watch: RoomWatch,
        joints: JointVector,
        true_flange: Array,
        frames: int,
        *,
        head: Array = IN_PLACE,
        cart: Array = IN_PLACE,
        sides: Sequence[float] | None = None,
        hidden: bool = False,
    ) -> RoomReading:
        """A reading with the arm truly there (4, 4), and head and cart moved (4, 4) in the robot frame."""
        spheres, frame = self._seen(true_flange, head, cart, frames)
        flange = self.kinematics.flange_pose(joints)
        seen = watch.robot_from_tracker @ frame
        return room_reading_of(
            flange,
            joints,
            spheres[:0] if hidden else spheres,
            frames,
            sides=None if sides is None else [int(side) for side in sides],
            arm=seen_frame(frame.as_matrix(), self.body_mm, frames),
            frame_mm=seen.translation_mm - self.frame_by_arm(flange).translation_mm,
        )

    def measured(self, spheres_mm: Array) -> Array:
        """One frame of spheres (n, 3) that stand there in the robot frame, tracker frame."""
        return self._measured(apply(self.tracker_from_robot, spheres_mm), 1)

    def true_flange(self, joints: JointVector) -> Array:
        """Where the arm truly is (4, 4) with its encoders at these joints."""
        return self._at(joints)[1]

    def guide_noise_mm(self, joints: JointVector) -> Array:
        """Of the frame on the mount, the lower end of the guide, and the frame on it, in one tracker frame.

        (9, 9) mm for each of nine standard normals.
        """
        mount = self.scene.mount
        end_in_tool_mm = (0.0, 0.0, -mount.guide.reach_mm)
        end_mm = apply(inverse(matrix_of(mount.tool_from_marker_true)), [end_in_tool_mm])[0]
        flange = self.tracker_from_robot @ self.true_flange(joints)
        on_guide = matrix_of(mount.flange_from_tool_true) @ matrix_of(mount.tool_from_tip_true)
        noise_mm = np.zeros((9, 9))
        noise_mm[:6, :6] = self._noise_mm(
            flange @ self.flange_from_marker, self.body_mm, (np.zeros(3), end_mm)
        )
        guide_frame = flange @ on_guide @ matrix_of(GUIDE_FRAME_IN_TIP)
        noise_mm[6:, 6:] = self._noise_mm(guide_frame, np.array(GUIDE_FRAME_MARKERS_MM), (np.zeros(3),))
        return noise_mm

    def _noise_mm(self, pose: Array, body_mm: Array, points_mm: Sequence[Array]) -> Array:
        """Of points in the frame of a body at this pose, as its fit has them: (3 n, 3 n)."""
        sight = self._optics.sight(apply(pose, body_mm))

        def fitted_mm(drawn: Array) -> Array:
            fit = fit_rigid_body(body_mm, sight.measured(drawn))
            return np.concatenate([fit.rotation @ point + fit.translation_mm for point in points_mm])

        step = 1e-3  # the fit is linear in noise as small as this
        still = fitted_mm(np.zeros(sight.mean_mm.shape))
        drawn = step * np.eye(sight.mean_mm.size).reshape(-1, *sight.mean_mm.shape)
        each = np.array([(fitted_mm(one) - still) / step for one in drawn])
        return np.asarray(np.linalg.qr(each, mode="r").T)

    def direction(self) -> Array:
        """A random unit vector."""
        way = self.generator.standard_normal(3)
        return np.asarray(way / np.linalg.norm(way))

    def _seen(self, true_flange: Array, head: Array, cart: Array, frames: int) -> tuple[Array, Transform]:
        flange = cart @ true_flange
        markers = apply(self.tracker_from_robot @ flange @ self.flange_from_marker, self.body_mm)
        spheres = apply(self.tracker_from_robot @ head, self.spheres_mm)
        points = self._measured(np.vstack([markers, spheres]), frames)
        fit = fit_rigid_body(self.body_mm, points[: len(markers)])
        pose = matrix_from(fit.translation_mm, fit.rotation)
        return points[len(markers) :], Transform.from_matrix(Frame.TRACKER, Frame.MARKER, pose)

    def _at(self, joints: JointVector) -> tuple[Transform, Array]:
        if joints not in self._poses:
            true = self._arm.moving(joints, FLANKS)
            self._poses[joints] = (self.kinematics.flange_pose(joints), true)
        return self._poses[joints]

    def _measured(self, points_mm: Array, frames: int) -> Array:
        return self.averaged(points_mm, frames, self.generator)

    def averaged(self, points_mm: Array, frames: int, generator: np.random.Generator) -> Array:
        """Points (n, 3) in the tracker frame as the mean of so many frames has them."""
        sight = self._optics.sight(points_mm)
        return sight.measured(generator.standard_normal(points_mm.shape) / math.sqrt(frames))

    def at_rest(self, joints: JointVector, sides: Sequence[int], motion: int) -> Array:
        """True flange (4, 4) at rest after a motion in which each joint came from that side."""
        return self._arm.at_rest(joints, sides, motion)

    def frame_by_arm(self, flange: Transform) -> Transform:
        """Pose of the frame on the mount by the arm."""
        records = self.records
        tool = records.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        return flange @ tool @ records.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)

    def _joints(self, pose: Transform) -> JointVector:
        tool = self.records.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
        flange = Pose.from_transform(pose @ tool.inverse())
        return self.kinematics.solve_branch(flange, self.kinematics.branch_of(self.home_rad), self.home_rad)
