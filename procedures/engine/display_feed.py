"""Display events for the state of a case: step order, upcoming step, devices and collision bodies."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from procedures.engine.events import EventStream, event_types
from procedures.workcell.device_views import DeviceView
from procedures.workcell.tools import MountedTool
from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.live_watch import PlacedBodies
from ronna_hw.arm.kinematics import COLUMN_NAME
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.devices.readings import ArmReading, StampedReading
from ronna_hw.devices.sensors import VolumeSections, measuring_volume_mm
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.workcell import Workcell

HOME = "home"  # comes when every step is done and the arm, or an instrument, is still out
BEYOND = 1.15  # times the distance of the tool's origin, where both cameras look, so that it lies inside
DECIMALS = 1  # of a millimetre
ROTATION_DECIMALS = 5
LINK_EVERY = 20  # looks from one report of the link to the next
PERIOD_S = 0.2  # host time between two looks: as often as a person can follow numbers
SEEN_MOVING_S = 0.05  # where an arm is drawn


def publish_order(engine: Engine) -> None:
    """Publish the case's steps in order."""
    specs = [(key, engine.order.spec(key)) for key in engine.order.sequence]
    engine.events.publish(
        event_types.Order(
            steps=tuple(
                event_types.OrderedStep(
                    step=str(key),
                    title=spec.title,
                    phase=str(spec.phase),
                    moves=spec.moves_an_arm,
                    record=engine.case.record_of(key),
                )
                for key, spec in specs
            )
        )
    )


def publish_waiting(engine: Engine) -> None:
    """Publish the upcoming step and the reasons, if any, why it cannot start."""
    key, name = engine.upcoming, upcoming_name(engine)
    if key is not None:
        unmet = engine.why_refused(key)
    else:
        arm = engine.setting.workcell.master.name
        fault = engine.faults.descriptions.get(arm) if name == HOME else None
        unmet = () if fault is None else (fault,)
    engine.events.publish(event_types.Waiting(upcoming=name, unmet=unmet))


def upcoming_name(engine: Engine) -> str | None:
    """Return the upcoming step, `home` if only parking remains, or None if the case is over."""
    if (key := engine.upcoming) is not None:
        return str(key)
    return HOME if engine.course.over and not engine.over else None


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
    """Collision bodies at the arm's last commanded joints. Queries no device."""

    def __init__(self, workcell: Workcell) -> None:
        self._workcell = workcell
        self._bodies_of: Surroundings | None = None
        self._bodies: Bodies | None = None
        self._published: Bodies | None = None
        self._looks = 0
        self._streamed = False  # at the last look
        self._cameras: tuple[event_types.CameraView, ...] = ()

    def at(self, pose: event_types.Pose) -> event_types.Pose:
        """Add the positions of the moving bodies to a pose, and that of a tool with cameras.

        A pose of another arm stays as it is: these are the bodies of the arm with the guide.
        """
        if pose.arm != self._workcell.master.name:
            return pose
        bodies, joints_rad = self._current(), pose.joints_rad
        places = tuple(_round_points(*segment) for segment in PlacedBodies(bodies, joints_rad))
        changes: dict[str, tuple[object, ...]] = {"bodies_mm": places}
        if (
            self._cameras and self._workcell.master.tool is MountedTool.STEREO_HEAD
        ):  # not while that is unchecked
            flange = self._workcell.master.flange_pose(joints_rad)
            tool = flange @ self._workcell.master.flange_from(MountedTool.STEREO_HEAD)
            x, y, z = tool.translation_mm.tolist()
            rows = (round(value, ROTATION_DECIMALS) for value in tool.rotation_matrix.ravel().tolist())
            changes |= {"tool_mm": _round_points((x, y, z)), "tool_rows": tuple(rows)}
        return pose.model_copy(update=changes)

    def publish(self, events: EventStream, *, last: bool = False) -> None:
        """Publish the bodies if they have changed, and the link health at intervals.

        The latter also when its stream has ended, and at the `last` look while it runs.
        """
        if self._current() is not self._published:
            self._published = self._current()
            event = _as_event(self._workcell.master.name, self._published)
            events.publish(event.model_copy(update={"cameras": self._cameras}))
        self._looks += 1
        was_streaming, self._streamed = self._streamed, self._workcell.master.streaming
        if self._streamed:
            is_due = last or self._looks % LINK_EVERY == 0
        else:
            is_due = was_streaming  # its last cycles
        if is_due:
            self._publish_link(events)

    def _current(self) -> Bodies:
        surroundings = self._workcell.master.surroundings
        if self._bodies is None or surroundings is not self._bodies_of:
            self._bodies_of = surroundings
            head = self._workcell.master.tool is MountedTool.STEREO_HEAD
            self._cameras = camera_views(self._workcell.calibrations.stereo_head) if head else ()
            self._bodies = Bodies(self._workcell.master.arm.kinematics, surroundings or Surroundings())
        return self._bodies

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


def _as_event(arm: str, bodies: Bodies) -> event_types.Bodies:
    names = (COLUMN_NAME, *(one.name for one in bodies.surroundings.obstacles))
    heads = (False, *(one.is_head for one in bodies.surroundings.obstacles))
    moving = zip(bodies.moving_names, bodies.moving_radii_mm, strict=True)
    return event_types.Bodies(
        arm=arm,
        moving=tuple(event_types.Body(name=name, radius_mm=radius_mm) for name, radius_mm in moving),
        fixed=tuple(
            event_types.Body(
                name=name,
                radius_mm=capsule.radius_mm,
                ends_mm=_round_points(capsule.start_mm, capsule.end_mm),
                is_head=is_head,
            )
            for name, capsule, is_head in zip(names, bodies.fixed, heads, strict=True)
        ),
        pairs=tuple(
            (pair.moving, pair.other) for pair in bodies.pairs if not (pair.enters_head and pair.is_head)
        ),
    )


def _round_points(*points: tuple[float, float, float]) -> tuple[float, ...]:
    return tuple(round(value, DECIMALS) for point in points for value in point)


class DeviceWatch:
    """Publisher of device states and faults on change, reading ages, and arm poses.

    It looks in a thread of its own while the `with` block runs, and once more at its end.
    """

    def __init__(
        self,
        devices: Mapping[str, DeviceView],
        events: EventStream,
        now_s: Callable[[], float],
        period_s: float = PERIOD_S,
        bodies: BodyView | None = None,
    ) -> None:
        """Watch `devices` by role; `now_s` returns theatre time, `period_s` is in host time.

        With `bodies` every pose says where the moving bodies are.
        """
        self._bodies = bodies
        self._devices = devices
        self._events = events
        self._now_s = now_s
        self._period_s = period_s
        self._states: dict[str, event_types.DeviceState] = {}
        self._volumes: dict[str, VolumeSections] = {}  # as published
        self._last_problem = ""  # the latest failure to look
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._look_repeatedly, name="device watch", daemon=True)

    def look(self, *, last: bool = False) -> None:
        """Observe every device once and publish the changes."""
        for role, device in self._devices.items():
            seen = device.observe()
            state = event_types.DeviceState(
                device=role,
                state=str(seen.state),
                fault=None if seen.fault is None else str(seen.fault),
                says=tuple(
                    event_types.DeviceFact(name=one.name, found=one.found, ready=one.ready)
                    for one in seen.says
                ),
                notices=device.notices,
            )
            if self._states.get(role) != state:
                self._states[role] = state
                self._events.publish(state)
                self._publish_volume(role, device)
            if not isinstance(seen.reading, StampedReading):
                continue
            reading = seen.reading
            age_s = max(0.0, self._now_s() - reading.stamp.theatre_time_s)
            count = None if isinstance(reading, ArmReading) else reading.stamp.sequence  # its link has cycles
            self._events.publish(
                event_types.DeviceAge(device=role, age_s=age_s, validity=reading.validity, readings=count)
            )
            if isinstance(seen.reading, ArmReading):
                joints_rad = seen.reading.joints_rad
                pose = event_types.Pose(arm=role, joints_rad=joints_rad, age_s=age_s)
                self._events.publish(pose if self._bodies is None else self._bodies.at(pose))
        if self._bodies is not None:
            self._bodies.publish(self._events, last=last)

    def _publish_volume(self, role: str, device: DeviceView) -> None:
        sections_mm = measuring_volume_mm(device)
        if sections_mm != self._volumes.get(role, ()):
            self._volumes[role] = sections_mm
            self._events.publish(event_types.MeasuringVolume(device=role, sections_mm=sections_mm))

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()
        self._look(last=True)

    def _look_repeatedly(self) -> None:
        while not self._ending.wait(self._period_s):
            self._look()

    def _look(self, *, last: bool = False) -> None:
        """Observe all devices, reporting a repeated failure only once and continuing the watch."""
        try:
            self.look(last=last)
        except Exception as problem:
            if str(problem) != self._last_problem:
                self._last_problem = str(problem)
                self._events.publish(_fault_event(problem))


def _fault_event(problem: Exception) -> event_types.Fault:
    if isinstance(problem, RonnaError):
        return event_types.Fault(code=problem.code, what=str(problem), advice=problem.advice)
    return event_types.Fault(code=type(problem).__name__, what=f"the devices cannot be observed: {problem}")
