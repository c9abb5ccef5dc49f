"""Looks at a single ball from planned poses, each approached from the same side."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from procedures.calibration import Observation, Outline
from procedures.calibration.pose_set import PlannedLook, move_look
from procedures.relocalization.errors import PairNotUsable
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell.centring import refusal, search_poses
from procedures.workcell.stereo_look import Look
from procedures.workcell.workcell import Workcell
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.calibration import PoseRecord
from ronna_hw.collision_config import BodyFrame, CollisionConfig, ToolBody
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector, Vector3, vector3

STAND_RADIUS_MM = 90.0  # the ball's stand is modelled as a post as thick as a head
STAND_BELOW_MM = 16.0  # from the ball's centre to the top of that post
STAND_LENGTH_MM = 400.0
NEIGHBOUR_RADIUS_MM = 7.0  # another ball, with the uncertainty of its position
ANOTHER_BALL_MM = 10.0  # from the expected position: more than the error of tool frame and arm


@dataclass
class BallWatcher:
    """Measures one ball repeatedly. `ball_mm` (3,) is its best known position in the robot frame."""

    workcell: Workcell
    ball_mm: Array
    rejected: Counter[str] = field(default_factory=Counter)
    last: Look | None = None

    def find(self, first: PlannedLook) -> Look:
        """Go to the first look and search in a spiral until the ball is in view. Raises STE-009."""

        def settle(pose: Transform) -> None:
            self._settle(self.workcell.master.joints_at(pose, self.workcell.master.home_rad))

        settle(first.pose)
        poses = search_poses(first.pose, settle, self.workcell.master.arm)
        while True:
            seen = self.workcell.look()
            if seen.point is not None:
                self.ball_mm = self.workcell.master.tool_pose().apply(seen.point.position_mm)
                return seen
            next(poses)

    def observe(self, planned: PlannedLook) -> Observation | None:
        """Measure the ball from a planned look; on failure, count the reason and return None."""
        seen = self.take(planned)
        return None if seen is None else self._build_observation(seen, planned.orientation)

    def take(self, planned: PlannedLook, arriving: Sequence[int] = ONE_SIDE) -> Look | None:
        """Take a planned look, each joint arriving from its given side; return None as for `observe`."""
        pose = move_look(planned, self.ball_mm).pose

        def settle() -> None:
            self._settle(self.workcell.master.joints_at(pose, self.workcell.master.joints_rad()), arriving)

        if (refused := refusal(settle, self.workcell.master.arm)) is not None:
            self.rejected[f"{refused.code} ({refused.meaning})"] += 1
            return None
        return self._look_or_none(planned.ball_in_tool_mm)

    def observe_at(self, joints: JointVector, orientation: int | None) -> Observation | None:
        """Measure the ball at given joint angles; return None if it is not seen. Raises motion errors."""
        self._settle(joints)
        seen = self._look_or_none(None)
        return None if seen is None else self._build_observation(seen, orientation)

    def observe_all(
        self, plan: Iterable[PlannedLook], wanted: int, progress: Callable[[int], None]
    ) -> list[Observation]:
        """Take planned looks until `wanted` of them have measured the ball."""
        taken: list[Observation] = []
        for planned in plan:
            if len(taken) >= wanted:
                break
            seen = self.observe(planned)
            if seen is not None:
                taken.append(seen)
                progress(len(taken))
        return taken

    def why_rejected(self) -> str:
        """Summarize why looks were rejected, most frequent reason first."""
        return ", ".join(f"{count} x {reason}" for reason, count in self.rejected.most_common(3))

    def _look_or_none(self, expected_in_tool_mm: Vector3 | None) -> Look | None:
        try:
            seen = self.last = self.workcell.look()
        except PairNotUsable as error:  # the next pose may have more luck
            self.rejected[error.what] += 1
            return None
        if seen.point is None or seen.left is None or seen.right is None:
            self.rejected[seen.reason] += 1
            return None
        if (
            expected_in_tool_mm is not None
            and math.dist(seen.point.position_mm, expected_in_tool_mm) > ANOTHER_BALL_MM
        ):
            self.rejected["another ball"] += 1
            return None
        return seen

    def _build_observation(self, seen: Look, orientation: int | None) -> Observation:
        workcell = self.workcell
        assert seen.left is not None, "a measurement without outlines is rejected"
        assert seen.right is not None, "a measurement without outlines is rejected"
        joints = workcell.master.joints_rad()
        flange = workcell.master.arm.kinematics.forward(joints)
        pose = PoseRecord(translation_mm=flange.position_mm, quaternion_wxyz=flange.quaternion())
        return Observation(
            joints_rad=joints,
            robot_from_flange=pose,
            left=Outline.of(seen.left),
            right=Outline.of(seen.right),
            orientation=orientation,
        )

    def _settle(self, joints: JointVector, arriving: Sequence[int] = ONE_SIDE) -> None:
        self.workcell.master.settle(joints, arriving, allow_detour=True)


def build_ball_surroundings(
    surroundings: CollisionConfig,
    flange_from_tool: Transform,
    ball_mm: ArrayLike,
    neighbours_mm: ArrayLike = (),
) -> Surroundings:
    """Build the stereo head's surroundings: the ball on its post, other balls (n, 3) mm, and the room."""
    x, y, z = ball = vector3(np.asarray(ball_mm))
    below = (x, y, z - STAND_BELOW_MM)
    obstacles = [*build_stand(ball), Obstacle("ball", Capsule(ball, below, NEIGHBOUR_RADIUS_MM))]
    for number, centre in enumerate(np.reshape(np.asarray(neighbours_mm, dtype=float), (-1, 3)), start=1):
        place = vector3(centre)
        obstacles.append(Obstacle(f"other ball {number}", Capsule(place, place, NEIGHBOUR_RADIUS_MM)))
    return build_free_surroundings(surroundings, flange_from_tool, surroundings.stereo_head, obstacles)


def build_stand(ball_mm: ArrayLike) -> tuple[Obstacle, ...]:
    """Build a ball's stand, excluding the ball."""
    x, y, z = vector3(np.asarray(ball_mm))
    top = z - STAND_BELOW_MM - STAND_RADIUS_MM
    body = Capsule((x, y, top), (x, y, top - STAND_LENGTH_MM), STAND_RADIUS_MM)
    return (Obstacle("ball's stand", body, True),)


def build_free_surroundings(
    surroundings: CollisionConfig,
    flange_from_tool: Transform,
    tool: Sequence[ToolBody],
    obstacles: Sequence[Obstacle] = (),
) -> Surroundings:
    """Build the surroundings of a tool without a patient: the room and any further obstacles."""
    standing = (body for body in surroundings.bodies if body.frame is BodyFrame.ROBOT)
    room = [Obstacle(body.name, body.capsule) for body in standing]
    flange = Pose.from_matrix(flange_from_tool.as_matrix().tolist())
    return surroundings.surround(tool, flange, [*obstacles, *room])
