"""Drives the arm from look to look about the ball, and measures, through the interfaces of the devices."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.calibration import Observation, Outline
from procedures.calibration.pose_set import PlannedLook, moved_to
from procedures.engine.step import StepContext
from procedures.relocalization import search_pose
from procedures.relocalization.errors import PairNotUsable
from procedures.steps.arm_frames import stereo_tool_in_flange
from procedures.steps.stereo_look import Look, look, whole_sensor
from ronna_hw.arm.clearance.capsule import Capsule
from ronna_hw.arm.clearance.surroundings import ArmRadii, Obstacle, Part, SpeedZone, Surroundings
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.pose import Pose
from ronna_hw.calibration import PoseRecord
from ronna_hw.collision_config import BodyFrame
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import JointVector, Vector3
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform

Array = NDArray[np.float64]

# Every pose is taken from the same side in every joint, so that backlash is the same in all of them.
APPROACH_RAD = math.radians(0.2)
STAND_RADIUS_MM = 90.0  # what carries the ball is taken for a post as thick as a head
STAND_BELOW_MM = 16.0  # from the ball's centre to the top of that post
STAND_LENGTH_MM = 400.0
NEIGHBOUR_RADIUS_MM = 7.0  # another ball, with what its coarse position leaves open
ANOTHER_BALL_MM = 10.0  # from where this one should be seen: more than tool frame and arm can be wrong by


@dataclass
class BallWatcher:
    """Looks at one ball. `ball_mm` is its place in the robot frame, as well as it is known so far."""

    context: StepContext
    ball_mm: Array
    home_rad: JointVector
    rejected: Counter[str] = field(default_factory=Counter)
    last: Look | None = None

    def begin(self) -> None:
        """Read the whole sensors from here on."""
        head = self.context.calibrations.stereo_head
        self.context.devices.stereo.set_areas(whole_sensor(head.left), whole_sensor(head.right))

    def find(self, first: PlannedLook) -> Look:
        """Go to the first look and, when the ball is not in view, around it in a spiral. Raises STE-009."""
        pose, looks = first.pose, 0
        while True:
            joints = self.joints(pose, self.home_rad)
            self._settle(joints)
            seen = look(self.context)
            if seen.point is not None:
                at = self._tool_pose(self.context.devices.arm.read_state().joints_rad)
                self.ball_mm = at.apply(seen.point.position_mm)
                return seen
            pose = search_pose(first.pose, looks)
            looks += 1

    def observe(self, planned: PlannedLook) -> Observation | None:
        """One look at the ball; None, and the reason counted, when it cannot be taken or shows no ball."""
        wanted = moved_to(planned, self.ball_mm)
        try:
            joints = self.joints(wanted.pose, self.context.devices.arm.read_state().joints_rad)
            self._settle(joints)
        except LimitError as error:
            if self.context.devices.arm.state is not Lifecycle.ACTIVE:  # not refused before it began: tripped
                raise
            self.rejected[error.code] += 1
            return None
        return self._observed(planned)

    def observe_at(self, joints: JointVector, orientation: int | None) -> Observation | None:
        """One look from given joint angles; raises what the move raises."""
        self._settle(joints)
        return self._observed(
            PlannedLook(self._tool_pose(joints), (0.0, 0.0, 0.0), orientation), elsewhere=True
        )

    def observe_all(
        self, plan: Iterable[PlannedLook], wanted: int, progress: Callable[[int], None]
    ) -> list[Observation]:
        """Looks from the plan until so many show the ball."""
        taken: list[Observation] = []
        for planned in plan:
            if len(taken) >= wanted:
                break
            seen = self.observe(planned)
            if seen is not None:
                taken.append(seen)
                progress(len(taken))
        return taken

    def joints(self, pose: Transform, near: JointVector) -> JointVector:
        """Joint angles of a tool pose in the branch of `near`; raises ARM-001 to ARM-004."""
        kinematics = self.context.devices.arm.kinematics
        flange = Pose.from_transform(pose @ stereo_tool_in_flange(self.context).inverse())
        return kinematics.solve_branch(flange, kinematics.branch_of(near), near)

    def reaches(self, pose: Transform) -> bool:
        """Whether the arm reaches a tool pose in the branch it stands in at home."""
        try:
            self.joints(pose, self.home_rad)
        except LimitError:
            return False
        return True

    def go_home(self) -> None:
        """Back to where the arm stood at the beginning."""
        self.context.devices.arm.move_joints(self.home_rad)

    def why_rejected(self) -> str:
        """The reasons, the most frequent first."""
        return ", ".join(f"{count} x {reason}" for reason, count in self.rejected.most_common(3))

    def _observed(self, planned: PlannedLook, *, elsewhere: bool = False) -> Observation | None:
        try:
            seen = self.last = look(self.context)
        except PairNotUsable as error:  # the next pose may have more luck
            self.rejected[error.what] += 1
            return None
        if seen.point is None or seen.left is None or seen.right is None:
            self.rejected[seen.reason] += 1
            return None
        if not elsewhere and math.dist(seen.point.position_mm, planned.ball_in_tool_mm) > ANOTHER_BALL_MM:
            self.rejected["another ball"] += 1
            return None
        joints = self.context.devices.arm.read_state().joints_rad
        flange = self.context.devices.arm.kinematics.forward(joints)
        return Observation(
            joints_rad=joints,
            robot_from_flange=PoseRecord(
                translation_mm=flange.position_mm, quaternion_wxyz=flange.quaternion()
            ),
            left=Outline.of(seen.left),
            right=Outline.of(seen.right),
            orientation=planned.orientation,
        )

    def _settle(self, joints: JointVector) -> None:
        A1, A2, A3, A4, A5, A6 = (angle - APPROACH_RAD for angle in joints)
        arm = self.context.devices.arm
        try:
            arm.move_joints((A1, A2, A3, A4, A5, A6))
        except NotClear:  # raised before anything moved
            arm.move_joints(self.home_rad)
            arm.move_joints((A1, A2, A3, A4, A5, A6))
        arm.move_joints(joints)

    def _tool_pose(self, joints: JointVector) -> Transform:
        return self.context.devices.arm.kinematics.flange_pose(joints) @ stereo_tool_in_flange(self.context)


def surround_ball(context: StepContext, ball_mm: ArrayLike, neighbours_mm: ArrayLike = ()) -> None:
    """Tell the arm what it carries and what stands around: the ball on its post, other balls, the room."""
    cell = context.theatre.cell
    flange = Pose.from_matrix(stereo_tool_in_flange(context).as_matrix().tolist())
    ball = _three(ball_mm)
    x, y, z = ball
    top = z - STAND_BELOW_MM - STAND_RADIUS_MM
    obstacles = [
        Obstacle("ball's stand", Capsule((x, y, top), (x, y, top - STAND_LENGTH_MM), STAND_RADIUS_MM), True),
        Obstacle("ball", Capsule(ball, (x, y, z - STAND_BELOW_MM), NEIGHBOUR_RADIUS_MM)),
    ]
    for number, centre in enumerate(np.reshape(np.asarray(neighbours_mm, dtype=float), (-1, 3)), start=1):
        place = _three(centre)
        obstacles.append(Obstacle(f"other ball {number}", Capsule(place, place, NEIGHBOUR_RADIUS_MM)))
    obstacles += [Obstacle(body.name, body.capsule) for body in cell.bodies if body.frame is BodyFrame.ROBOT]
    arm, zone = cell.arm, cell.zone
    context.devices.arm.surround(
        Surroundings(
            tool=tuple(
                Part(one.name, one.capsule.moved(flange), one.enters_head) for one in cell.stereo_head
            ),
            obstacles=tuple(obstacles),
            radii=ArmRadii(arm.column_mm, arm.upper_arm_mm, arm.forearm_mm, arm.wrist_mm, arm.hand_mm),
            margin_mm=cell.margin_mm,
            live_margin_mm=cell.live_margin_mm,
            zone=SpeedZone(zone.near_mm, zone.near_speed_mm_s, zone.far_mm, zone.far_speed_mm_s),
        )
    )


def _three(values: ArrayLike) -> Vector3:
    x, y, z = np.asarray(values, dtype=float).tolist()
    return (x, y, z)
