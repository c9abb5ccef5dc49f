"""Positions of collision bodies and distances between arms, for display.

Every arm is drawn in the robot frame, which is the base of the first. An arm whose base is not known yet is
not drawn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from procedures.engine.events import EventStream, event_types
from procedures.workcell.placed_arms import PlacedArms, RolePair
from procedures.workcell.tools import MountedTool
from ronna_hw.arm.clearance.arm_pair import Closeness, PlacedArm, name_of
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.live_pair import LivePair
from ronna_hw.arm.clearance.live_watch import PlacedBodies
from ronna_hw.arm.kinematics import COLUMN_NAME
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    from procedures.workcell import Workcell
    from procedures.workcell.supervised_arm import SupervisedArm

BEYOND = 1.15  # times the distance of the tool's origin, where both cameras look, so that it lies inside
DECIMALS = 1  # of a millimetre
ROTATION_DECIMALS = 5
LINK_EVERY = 20  # looks from one report of the link to the next


def camera_views(head: StereoHeadCalibration) -> tuple[event_types.CameraView, ...]:
    """Return each camera's centre and image corners in the tool frame (mm), ignoring distortion."""
    views = []
    for name, camera in (("left", head.left), ("right", head.right)):
        tool_from_camera = camera.camera_from_tool.transform(Frame.CAMERA_LEFT, Frame.TOOL).inverse()
        centre = tool_from_camera.translation_mm
        depth_mm = BEYOND * float(np.linalg.norm(centre))
        columns, rows = camera.sensor_px
        pixels = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], dtype=float)
        slopes = (pixels - camera.principal_point_px) / camera.focal_px
        corners = tool_from_camera.apply(depth_mm * np.column_stack([slopes, np.ones(len(slopes))]))
        points = np.vstack([centre, corners]).round(DECIMALS)
        views.append(event_types.CameraView(name=name, points_mm=tuple(points.ravel().tolist())))
    return tuple(views)


class BodyView:
    """Collision bodies of every arm at its last reported joints. Queries no device."""

    def __init__(self, workcell: Workcell) -> None:
        self._workcell = workcell
        self._arms = {arm.name: _ArmBodies(workcell, arm) for arm in workcell.arms.values()}
        self._distances = {pair: _Distance(pair) for pair in workcell.motion.placed.pairs}
        self._looks = 0
        self._streamed = False  # at the last look

    def at(self, pose: event_types.Pose) -> event_types.Pose:
        """Add the positions of the arm's moving bodies to a pose, and that of a tool with cameras."""
        return self._arms[pose.arm].at(pose)

    def publish(self, events: EventStream, *, last: bool = False) -> None:
        """Publish changed bodies, distances and link health.

        Link health is published every `LINK_EVERY` looks, at the `last` one and when streaming has ended.
        """
        for arm in self._arms.values():
            arm.publish(events)
        self._publish_distances(events)
        self._looks += 1
        was_streaming, self._streamed = self._streamed, self._workcell.master.streaming
        if self._streamed:
            is_due = last or self._looks % LINK_EVERY == 0
        else:
            is_due = was_streaming  # its last cycles
        if is_due:
            self._publish_link(events)

    def _publish_distances(self, events: EventStream) -> None:
        by_role = {arm.role: arm for arm in self._arms.values()}
        for pair, distance in self._distances.items():
            found = distance.measure(self._workcell.motion.placed, by_role[pair.first], by_role[pair.second])
            if found is not None:
                events.publish(found)

    def _publish_link(self, events: EventStream) -> None:
        try:
            link = self._workcell.master.link_statistics()
        except RonnaError:  # its connection has just ended
            return
        events.publish(
            event_types.LinkHealth(
                cycles=link.cycles,
                late=link.late_cycles,
                lost=link.lost_cycles,
                rejected=link.rejected_telegrams,
                turnaround_median_us=link.turnaround_median_us,
                turnaround_p99_us=link.turnaround_p99_us,
            )
        )


class _ArmBodies:
    """Placed bodies of one arm, rebuilt when its surroundings or its base change."""

    def __init__(self, workcell: Workcell, arm: SupervisedArm) -> None:
        self._workcell, self._arm, self.role, self.name = workcell, arm, arm.role, arm.name
        self._around: Surroundings | None = None
        self._placed: PlacedArm | None = None
        self._published: PlacedArm | None = None
        self._cameras: tuple[event_types.CameraView, ...] = ()
        self.joints_rad: JointVector | None = None  # as last reported

    def at(self, pose: event_types.Pose) -> event_types.Pose:
        """Add body positions and the pose of a tool with cameras to a pose event, if the base is known."""
        self.joints_rad = pose.joints_rad
        if (placed := self.current()) is None:
            return pose
        segments = PlacedBodies(placed.bodies, pose.joints_rad)
        places = tuple(_round_points(*map(placed.base.apply, segment)) for segment in segments)
        changes: dict[str, tuple[object, ...]] = {"bodies_mm": places}
        if self._cameras and self._carries_head:  # not while that is unchecked
            master = self._workcell.master
            tool = master.flange_pose(pose.joints_rad) @ master.flange_from(MountedTool.STEREO_HEAD)
            x, y, z = tool.translation_mm.tolist()
            rows = (round(value, ROTATION_DECIMALS) for value in tool.rotation_matrix.ravel().tolist())
            changes |= {"tool_mm": _round_points((x, y, z)), "tool_rows": tuple(rows)}
        return event_types.Pose.model_validate({**dict(pose), **changes})

    def publish(self, events: EventStream) -> None:
        """Publish the bodies if they have changed."""
        placed = self.current()
        if placed is not None and placed is not self._published:
            self._published = placed
            events.publish(self._as_event(placed))

    def current(self) -> PlacedArm | None:
        """Return the bodies as last declared, or None while the base is not known."""
        arms = self._workcell.motion.placed
        if not arms.is_placed(self.role):
            return None
        around, base = arms.around[self.role], arms.base(self.role)
        if self._placed is None or around is not self._around or base is not self._placed.base:
            self._around = around
            head = self._workcell.calibrations.stereo_head
            self._cameras = camera_views(head) if self._carries_head else ()
            self._placed = arms.arm(self.role)
        return self._placed

    def display_name(self, body: str) -> str:
        """Return a body's display name: bodies of the arm with the guide have no arm in theirs."""
        return body if self._is_master else name_of(body, self._arm.spoken_name)

    @property
    def _is_master(self) -> bool:
        return self._arm is self._workcell.master

    @property
    def _carries_head(self) -> bool:
        return self._is_master and self._workcell.master.tool is MountedTool.STEREO_HEAD

    def _as_event(self, placed: PlacedArm) -> event_types.Bodies:
        bodies, name = placed.bodies, self.display_name
        obstacles = bodies.surroundings.obstacles
        names = (name(COLUMN_NAME), *(one.name for one in obstacles))
        heads = (False, *(one.is_head for one in obstacles))
        moving = zip(bodies.moving_names, bodies.moving_radii_mm, strict=True)
        return event_types.Bodies(
            arm=self.name,
            moving=tuple(event_types.Body(name=name(one), radius_mm=radius_mm) for one, radius_mm in moving),
            links=len(bodies.moving_names) - len(bodies.surroundings.tool),
            margin_mm=bodies.surroundings.margin_mm,
            fixed=tuple(
                event_types.Body(
                    name=one,
                    radius_mm=capsule.radius_mm,
                    ends_mm=_round_points(*map(placed.base.apply, (capsule.start_mm, capsule.end_mm))),
                    is_head=is_head,
                )
                for one, capsule, is_head in zip(names, bodies.fixed, heads, strict=True)
            ),
            pairs=tuple(
                (pair.moving, pair.other) for pair in bodies.pairs if not (pair.enters_head and pair.is_head)
            ),
            cameras=self._cameras,
            with_guide=self._is_master,
        )


class _Distance:
    """Distance between two arms, measured again once one has moved.

    Bodies that may touch, as a clamp and the instrument's guide, are left out.
    """

    def __init__(self, pair: RolePair) -> None:
        self._pair = pair
        self._first: PlacedArm | None = None
        self._second: PlacedArm | None = None
        self._live: LivePair | None = None
        self._contacts: frozenset[tuple[str, str]] = frozenset()
        self._at_rad: tuple[JointVector, JointVector] | None = None

    def measure(
        self, arms: PlacedArms, first: _ArmBodies, second: _ArmBodies
    ) -> event_types.ArmsApart | None:
        """Return the distance, or None if it is unknown or as before."""
        one, other = first.current(), second.current()
        if one is None or other is None or first.joints_rad is None or second.joints_rad is None:
            return None
        at_rad, contacts = (first.joints_rad, second.joints_rad), arms.contacts(self._pair)
        same = self._first is one and self._second is other and self._contacts == contacts
        if self._live is None or not same:
            self._live = LivePair(one, other, Closeness(contacts))
            self._first, self._second, self._contacts = one, other, contacts
        elif at_rad == self._at_rad:
            return None
        self._at_rad = at_rad
        found = self._live.distance(*at_rad)
        if not found.first:
            return None
        return event_types.ArmsApart(
            arms=(first.name, second.name),
            bodies=(first.display_name(found.first), second.display_name(found.second)),
            distance_mm=round(found.distance_mm, DECIMALS),
        )


def _round_points(*points: Vector3) -> tuple[float, ...]:
    return tuple(round(value, DECIMALS) for point in points for value in point)
