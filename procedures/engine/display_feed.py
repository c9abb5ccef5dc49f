"""Display events for the state of a case: step order, upcoming step, devices."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Self

from procedures.engine.body_view import BodyView
from procedures.engine.events import EventStream, event_types
from procedures.workcell.device_views import DeviceView
from ronna_hw.devices.readings import ArmReading, StampedReading
from ronna_hw.devices.sensors import VolumeSections, measuring_volume_mm
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

HOME = "home"  # comes when every step is done and the arm, or an instrument, is still out
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
                    doubt=engine.case.doubt_at(key) or "",
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
