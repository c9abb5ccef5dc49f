"""The arm and what is around it as the bodies that motions are checked against, for displays."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from procedures.engine.camera_view import camera_views
from procedures.engine.events import Bodies as BodiesEvent
from procedures.engine.events import Body, CameraView, EventStream, LinkHealth, Pose
from procedures.workcell.tools import MountedTool
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Surroundings
from ronna_hw.arm.clearance.live_watch import body_segments
from ronna_hw.arm.kinematics import COLUMN_NAME
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.workcell import Workcell

DECIMALS = 1  # of a millimetre: finer than anybody sees
ROTATION_DECIMALS = 5
LINK_EVERY = 20  # looks from one report of the link to the next


class BodyView:
    """What the workcell's arm was last given, and where its bodies are. Asks no device."""

    def __init__(self, workcell: Workcell) -> None:
        self._workcell = workcell
        self._bodies_of: Surroundings | None = None
        self._bodies: Bodies | None = None
        self._published: Bodies | None = None
        self._looks = 0
        self._streamed = False  # at the last look
        self._cameras: tuple[CameraView, ...] = ()

    def at(self, pose: Pose) -> Pose:
        """The pose with the place of each moving body, and of the tool where it has cameras."""
        bodies, joints_rad = self._current(), cast("JointVector", pose.joints_rad)
        places = tuple(_rounded(*segment) for segment in body_segments(bodies, joints_rad))
        changes: dict[str, tuple[object, ...]] = {"bodies_mm": places}
        if self._cameras and self._workcell.tool is MountedTool.STEREO_HEAD:  # not while that is unchecked
            flange = self._workcell.flange_pose(joints_rad)
            tool = flange @ self._workcell.flange_from(MountedTool.STEREO_HEAD)
            x, y, z = tool.translation_mm.tolist()
            rows = (round(value, ROTATION_DECIMALS) for value in tool.rotation_matrix.ravel().tolist())
            changes |= {"tool_mm": _rounded((x, y, z)), "tool_rows": tuple(rows)}
        return pose.model_copy(update=changes)

    def publish(self, events: EventStream, *, last: bool = False) -> None:
        """Publish the bodies if they are others than before, and now and then the health of the link.

        The link's also once its stream has ended, and at the `last` look while it has not.
        """
        if self._current() is not self._published:
            self._published = self._current()
            event = _as_event(self._published)
            events.publish(event.model_copy(update={"cameras": self._cameras}))
        self._looks += 1
        streamed, self._streamed = self._streamed, self._workcell.streaming
        if self._streamed:
            due = last or self._looks % LINK_EVERY == 0
        else:
            due = streamed  # its last cycles
        if due:
            self._publish_link(events)

    def _current(self) -> Bodies:
        surroundings = self._workcell.surroundings
        if self._bodies is None or surroundings is not self._bodies_of:
            self._bodies_of = surroundings
            head = self._workcell.tool is MountedTool.STEREO_HEAD
            self._cameras = camera_views(self._workcell.calibrations.stereo_head) if head else ()
            self._bodies = Bodies(self._workcell.arm.kinematics, surroundings or Surroundings())
        return self._bodies

    def _publish_link(self, events: EventStream) -> None:
        try:
            link = self._workcell.link_statistics()
        except RonnaError:  # its connection has just ended
            return
        events.publish(
            LinkHealth(
                cycles=link.cycles,
                late=link.late_cycles,
                lost=link.lost_cycles,
                rejected=link.rejected_telegrams,
                turnaround_median_us=link.turnaround_median_us,
                turnaround_p99_us=link.turnaround_p99_us,
            )
        )


def _as_event(bodies: Bodies) -> BodiesEvent:
    names = (COLUMN_NAME, *(one.name for one in bodies.surroundings.obstacles))
    heads = (False, *(one.is_head for one in bodies.surroundings.obstacles))
    moving = zip(bodies.moving_names, bodies.moving_radii_mm, strict=True)
    return BodiesEvent(
        moving=tuple(Body(name=name, radius_mm=radius_mm) for name, radius_mm in moving),
        fixed=tuple(
            _fixed(name, capsule, is_head)
            for name, capsule, is_head in zip(names, bodies.fixed, heads, strict=True)
        ),
        pairs=tuple(
            (pair.moving, pair.other) for pair in bodies.pairs if not (pair.enters_head and pair.is_head)
        ),
    )


def _fixed(name: str, capsule: Capsule, is_head: bool) -> Body:
    ends_mm = _rounded(capsule.start_mm, capsule.end_mm)
    return Body(name=name, radius_mm=capsule.radius_mm, ends_mm=ends_mm, is_head=is_head)


def _rounded(*points: tuple[float, float, float]) -> tuple[float, ...]:
    return tuple(round(value, DECIMALS) for point in points for value in point)
