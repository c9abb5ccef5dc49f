"""Looks at the devices a few times a second and publishes what it sees; asks none of them anything."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Self

from procedures.engine.body_view import BodyView
from procedures.engine.events import (
    DeviceAge,
    DeviceFact,
    DeviceState,
    EventStream,
    Fault,
    MeasuringVolume,
    Pose,
)
from procedures.workcell.device_views import DeviceView
from ronna_hw.devices.readings import ArmReading, StampedReading
from ronna_hw.devices.sensors import BoundedTracker
from ronna_hw.errors import RonnaError

PERIOD_S = 0.2  # host time between two looks: as often as a person can follow numbers
SEEN_MOVING_S = 0.05  # where an arm is drawn


class DeviceWatch:
    """State and fault of every device when they change, the age of its newest reading, arm positions.

    It looks in a thread of its own for the length of a `with` block, once more at its end.
    """

    def __init__(
        self,
        devices: Mapping[str, DeviceView],
        events: EventStream,
        now_s: Callable[[], float],
        period_s: float = PERIOD_S,
        bodies: BodyView | None = None,
    ) -> None:
        """`devices` by role; `now_s` is the theatre's time, `period_s` the host's.

        With `bodies` every pose says where the moving bodies are.
        """
        self._bodies = bodies
        self._devices = devices
        self._events = events
        self._now_s = now_s
        self._period_s = period_s
        self._states: dict[str, DeviceState] = {}
        self._bounded: set[str] = set()  # trackers whose volume was told
        self._last_problem = ""  # what it could not see last
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._look_on, name="device watch", daemon=True)

    def look(self, *, last: bool = False) -> None:
        """Publish what is new about every device."""
        for role, device in self._devices.items():
            seen = device.observe()
            state = DeviceState(
                device=role,
                state=str(seen.state),
                fault=None if seen.fault is None else str(seen.fault),
                says=tuple(DeviceFact(name=one.name, found=one.found, ready=one.ready) for one in seen.says),
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
                DeviceAge(device=role, age_s=age_s, validity=reading.validity, readings=count)
            )
            if isinstance(seen.reading, ArmReading):
                joints_rad = seen.reading.joints_rad
                pose = Pose(arm=role, joints_rad=joints_rad, age_s=age_s)
                self._events.publish(pose if self._bodies is None else self._bodies.at(pose))
        if self._bodies is not None:
            self._bodies.publish(self._events, last=last)

    def _publish_volume(self, role: str, device: DeviceView) -> None:
        """Where a tracker measures, once it is known."""
        if role in self._bounded or not isinstance(device, BoundedTracker):
            return
        if sections_mm := device.volume_sections_mm:
            self._bounded.add(role)
            self._events.publish(MeasuringVolume(device=role, sections_mm=sections_mm))

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()
        self._look(last=True)

    def _look_on(self) -> None:
        while not self._ending.wait(self._period_s):
            self._look()

    def _look(self, *, last: bool = False) -> None:
        """It looks again, and what it cannot see is reported once; nothing else ends by it."""
        try:
            self.look(last=last)
        except Exception as problem:
            if str(problem) != self._last_problem:
                self._last_problem = str(problem)
                self._events.publish(_fault(problem))


def _fault(problem: Exception) -> Fault:
    if isinstance(problem, RonnaError):
        return Fault(code=problem.code, what=str(problem), advice=problem.advice)
    return Fault(code=type(problem).__name__, what=f"the devices cannot be observed: {problem}")
