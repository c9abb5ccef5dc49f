"""View of one camera: the visible spheres and the image disturbances."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import pi, radians

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.room_tasks import OnStand
from sim.basler.camera.line_view import LineView
from sim.basler.optics.canvas import Area
from sim.basler.optics.film import draw_stains
from sim.basler.optics.laser_line import LineRun
from sim.basler.optics.picture import CLEAR, Glare, Occluder, PictureDisturbance
from sim.basler.optics.sphere import DrawnSphere
from sim.world.displacements import NOTHING_MOVED, RoomShift, ShiftedRoom, spheres_in_theatre
from sim.world.faults import Fault, FaultBoard
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import apply, inverse, matrix_from, matrix_of, rotation_from_vector, rotation_towards
from sim.world.scene.model import SPHERE_RADIUS_MM, CameraTruth, Fiducial, Head
from sim.world.world import World

FURTHEST_MM = 1000.0  # beyond this, a sphere is a faint spot far out of focus

Pose = NDArray[np.float64]

PERCENT = 0.01
SECONDS_PER_MINUTE = 60.0


class View:
    """The spheres in front of one camera.

    In the scene `bench`, until an arm moves the head, any client sees a sphere in both images: the first
    fiducial is at the tool centre point with its post along the tool's z axis.
    """

    def __init__(self, world: World, camera: CameraTruth) -> None:
        self._world = world
        self._camera_from_tool = matrix_of(camera.camera_from_tool)
        head = world.scene.head
        self._fiducials = (*spheres_in_theatre(world.scene), *_target_balls(head))
        self._numbers = [each.number for each in self._fiducials]
        self._robot_from_ct = matrix_of(head.robot_from_ct)
        self._centres_mm = apply(
            self._robot_from_ct, np.array([each.centre_ct_mm for each in self._fiducials]).reshape(-1, 3)
        )
        self._stand_mm = np.array(world.scene.stand.ball_mm)
        self._stand_number = 1 + max((each.number for each in self._fiducials), default=0)
        self._room = ShiftedRoom(world)
        self._line = LineView(world.scene, camera)

    def pose(self) -> Pose | None:
        """Return the true head pose (4, 4) in the robot frame, or None before an arm has published it."""
        pose = self._world.robot_from_tool()
        return pose if np.any(pose[:3, :3]) else None

    @property
    def head_mounted(self) -> bool:
        """Whether the stereo head is mounted."""
        return self._world.mounted_tool() == self._world.scene.mount.tool_number_stereo

    def holder_flanges(self) -> dict[ArmRole, Pose]:
        """Return the true flange (4, 4), in its base, of each arm that holds a ball."""
        world = self._world
        roles = (role for role in world.scene.holders if world.has_arm(role))
        return {role: world.arm(role).robot_from_flange for role in roles}

    @property
    def stand_has_ball(self) -> bool:
        """Whether the ball is on the calibration stand."""
        return self._world.on_stand() is OnStand.BALL

    def spheres(
        self, robot_from_tool: Pose | None, twist_rad: float = 0.0, room: RoomShift = NOTHING_MOVED
    ) -> tuple[DrawnSphere, ...]:
        """Return the spheres in front of the camera, in the camera frame, for a pose returned by `pose`.

        `twist_rad` turns the camera in its mount, about an axis through its centre of projection across the
        plane of both cameras: the tool's x axis. `room` is the displacement of the spheres.
        """
        if not self.head_mounted:
            return ()  # on its stand the head sees nothing
        if robot_from_tool is None:
            return (
                self._bench_spheres(self._twist_pose(twist_rad)) if self._world.scene.name == "bench" else ()
            )
        camera_from_robot = self._twist_pose(twist_rad) @ inverse(robot_from_tool)
        centres = apply(camera_from_robot, room.displace_spheres_mm(self._centres_mm, self._numbers))
        rotation = camera_from_robot[:3, :3] @ self._robot_from_ct[:3, :3]
        seen = [
            DrawnSphere(centre, each.radius_mm, rotation @ _rotation_along_post(each.post_ct), each.number)
            for each, centre in zip(self._fiducials, centres, strict=True)
        ]
        if self.stand_has_ball:
            centre = apply(camera_from_robot, self._stand_mm)
            upright = camera_from_robot[:3, :3] @ _rotation_along_post((0.0, 0.0, 1.0))
            seen.append(DrawnSphere(centre, SPHERE_RADIUS_MM, upright, self._stand_number))
        for number, (role, flange) in enumerate(self.holder_flanges().items(), self._stand_number + 1):
            holder = self._world.scene.holders[role]
            pose = camera_from_robot @ self._room.robot_from_base(role, room) @ flange
            centre = apply(pose, holder.flange_from_ball_mm)
            along = pose[:3, :3] @ _rotation_along_post((0.0, 0.0, 1.0))  # the post, from the flange
            seen.append(DrawnSphere(centre, holder.ball_radius_mm, along, number))
        return tuple(one for one in seen if 0.0 < one.centre_mm[2] < FURTHEST_MM)

    def line(
        self, area: Area, robot_from_tool: Pose | None, disturbance: PictureDisturbance
    ) -> tuple[LineRun, ...]:
        """Return the lit projector's line in an area of the picture, for a pose returned by `pose`."""
        if not self.head_mounted or disturbance.line_dark:
            return ()
        twist_rad, room = disturbance.twist_rad, disturbance.room
        return self._line.runs(
            area,
            robot_from_tool,
            self._twist_pose(twist_rad),
            self.spheres(robot_from_tool, twist_rad, room),
            room,
            disturbance.hand_mm,
        )

    def _twist_pose(self, angle_rad: float) -> Pose:
        across = self._camera_from_tool[:3, 0]  # the tool's x axis in the camera's frame
        turn = matrix_from((0.0, 0.0, 0.0), rotation_from_vector(angle_rad * across))
        return turn @ self._camera_from_tool if angle_rad else self._camera_from_tool

    def _bench_spheres(self, camera_from_tool: Pose) -> tuple[DrawnSphere, ...]:
        if not self._fiducials:
            return ()
        first = self._fiducials[0]
        rotation = camera_from_tool[:3, :3] @ _rotation_along_post((0.0, 0.0, -1.0))
        return (DrawnSphere(camera_from_tool[:3, 3], first.radius_mm, rotation, first.number),)


class ViewDisturbances:
    """Optical disturbances of one camera, as defined by the fault script and the scene."""

    def __init__(self, world: World, camera: CameraTruth) -> None:
        self._world = world
        self._camera = camera
        self._board = FaultBoard(world, "camera")
        self._room = ShiftedRoom(world)
        self._side = "left" if camera.serial == world.scene.left.serial else "right"

    @cached_property
    def _worn(self) -> PictureDisturbance:
        """Worn spots of the film: permanent defects, as dark as a stain."""
        scene = self._world.scene
        spots = tuple(
            (one.number, draw_stains(scene.seed, one.number, one.worn_percent * PERCENT))
            for one in spheres_in_theatre(scene)
            if one.worn_percent
        )
        return PictureDisturbance(stains=spots) if spots else CLEAR

    def now(self) -> PictureDisturbance:
        """Return the active disturbances, using only a single query when there are no faults."""
        room = self._room.now()
        if self._board.empty:
            return self._worn if room is NOTHING_MOVED else replace(self._worn, room=room)
        seed = self._world.scene.seed
        return PictureDisturbance(
            stains=self._worn.stains
            + tuple(
                (int(number), draw_stains(seed, int(number), float(share) * PERCENT))
                for number, share in (fault.arguments for fault in self._board.active("stain"))
            ),
            occluders=tuple(
                self._draw_occluder(float(fault.arguments[1])) for fault in self._own_faults("occluder")
            ),
            glares=tuple(self._draw_glare(float(fault.arguments[1])) for fault in self._own_faults("glare")),
            twist_rad=sum(radians(float(fault.arguments[1])) for fault in self._own_faults("twist"))
            + sum(self._drift_rad(fault) for fault in self._own_faults("creep")),
            room=room,
            lamp_share=sum(float(fault.argument) for fault in self._board.active("lamp")) * PERCENT,
            hand_mm=min((float(fault.argument) for fault in self._board.active("hand")), default=None),
            line_dark=bool(self._board.active("no_laser")),
        )

    def _own_faults(self, kind: str) -> list[Fault]:
        return [fault for fault in self._board.active(kind) if fault.argument == self._side]

    def _drift_rad(self, fault: Fault) -> float:
        """Return the drift in rad accumulated since the onset of the fault or the start of its step."""
        begun_s = self._world.step()[1] / 1e9 if fault.at_s is None else fault.at_s
        acting_s = self._world.clock.now_s() - begun_s
        return radians(float(fault.arguments[1])) * acting_s / SECONDS_PER_MINUTE

    def _draw_occluder(self, share_percent: float) -> Occluder:
        direction = noise(self._world.scene.seed, f"occluder of camera {self._camera.serial}", 0)
        return Occluder(share_percent * PERCENT, float(direction.uniform(0.0, 2.0 * pi)))

    def _draw_glare(self, radius_px: float) -> Glare:
        place = noise(self._world.scene.seed, f"glare of camera {self._camera.serial}", 0)
        columns, rows = self._camera.sensor_px
        return Glare((float(place.uniform(0, columns)), float(place.uniform(0, rows))), radius_px)


def _target_balls(head: Head) -> tuple[Fiducial, ...]:
    """Return the balls at the targets, on posts along the trajectories."""
    if not head.target_balls:
        return ()
    first = 1 + max((each.number for each in head.fiducials), default=0)
    return tuple(
        Fiducial(number=number, centre_ct_mm=each.target_ct_mm, post_ct=each.outwards_ct)
        for number, each in enumerate(head.targets, first)
    )


def _rotation_along_post(post: tuple[float, float, float]) -> Pose:
    """Return a rotation (3, 3) whose third column is the post, with an arbitrary but fixed roll."""
    hint = (0.0, 0.0, 1.0) if abs(post[2]) < max(abs(post[0]), abs(post[1])) else (1.0, 0.0, 0.0)
    return rotation_towards(post, hint)
