"""Obstacles around the arm for motion planning: head and spheres from the CT, x-shaped frame, room."""

from __future__ import annotations

from dataclasses import dataclass, replace

from numpy.typing import ArrayLike

from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_model import FiducialKind
from procedures.registration.template import find_layout
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.clearance.bodies import Capsule, Corridor, Obstacle, Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.collision_config import CollisionConfig, ToolBody
from ronna_hw.frames import Transform
from ronna_hw.vectors import vector3
from ronna_hw.x_frame import SPHERE_CENTRES_MM, bodies

Points = tuple[tuple[float, float, float], ...]
COARSE_MM = 1.25  # around them: error of the coarse localization


@dataclass(frozen=True)
class PlanningScene:
    """Head found in the CT, and the surrounding bodies from the theatre file."""

    surroundings: CollisionConfig
    head: HeadEllipsoid
    fiducials_ct_mm: Points = ()
    frame_ct: tuple[Obstacle, ...] = ()  # bars and foot of the x-shaped frame
    head_reserve_mm: float = 0.0

    def with_reserve(self, reserve_mm: float) -> PlanningScene:
        """Return the scene with additional clearance while the stereo head is mounted."""
        return replace(self, head_reserve_mm=reserve_mm)

    def around_rough_head(self, rough_mm: float) -> PlanningScene:
        """Return the scene with a head that is larger on all sides, as its place is known no better."""
        x_mm, y_mm, z_mm = self.head.semi_axes_mm
        larger_mm = (x_mm + rough_mm, y_mm + rough_mm, z_mm + rough_mm)
        frame = tuple(
            one._replace(capsule=one.capsule._replace(radius_mm=one.capsule.radius_mm + rough_mm))
            for one in self.frame_ct
        )
        return replace(self, head=self.head.model_copy(update={"semi_axes_mm": larger_mm}), frame_ct=frame)

    def with_stereo_head(
        self, robot_from_ct: Transform, flange_from_tool: Transform, trajectory: Trajectory | None = None
    ) -> Surroundings:
        """Return the surroundings for localizing the spheres, or a ball at a trajectory's target."""
        around = self._around(self.surroundings.stereo_head, robot_from_ct, flange_from_tool, trajectory)
        return replace(around, margin_mm=around.margin_mm + self.head_reserve_mm)

    def with_guide(
        self, robot_from_ct: Transform, flange_from_tool: Transform, trajectory: Trajectory | None
    ) -> Surroundings:
        """Return the surroundings with the guide mounted, leaving this trajectory's corridor open."""
        return self._around(self.surroundings.guide, robot_from_ct, flange_from_tool, trajectory)

    def _around(
        self,
        tool: tuple[ToolBody, ...],
        robot_from_ct: Transform,
        flange_from_tool: Transform,
        trajectory: Trajectory | None,
    ) -> Surroundings:
        corridor = None
        if trajectory is not None:
            entry, target = robot_from_ct.apply([trajectory.entry_mm, trajectory.target_mm]).tolist()
            corridor = Corridor(tuple(entry), tuple(target), self.surroundings.corridor_mm)
        in_robot = Pose.from_matrix(robot_from_ct.as_matrix().tolist())
        around = self.surroundings.build_surroundings(
            tool,
            Pose.from_matrix(flange_from_tool.as_matrix().tolist()),
            Pose(in_robot.apply(self.head.centre_mm), in_robot.rotation),
            self.head.semi_axes_mm,
            tuple(in_robot.apply(point) for point in self.fiducials_ct_mm),
            corridor,
        )
        frame = (one._replace(capsule=one.capsule.moved(in_robot)) for one in self.frame_ct)
        return replace(around, obstacles=(*around.obstacles, *frame))


def build_frame_bodies(fiducials: FiducialKind, spheres_ct_mm: ArrayLike) -> tuple[Obstacle, ...]:
    """Place the rods of the x-shaped frame in the CT, or none for free spheres. Raises REG-012."""
    if fiducials is not FiducialKind.XFRAME:
        return ()
    place = find_layout(SPHERE_CENTRES_MM, spheres_ct_mm).scan_from_layout
    found = []
    for one in bodies():
        start_mm, end_mm = map(vector3, place.apply([one.start_mm, one.end_mm]))
        found.append(Obstacle(one.name, Capsule(start_mm, end_mm, one.radius_mm + COARSE_MM)))
    return tuple(found)
