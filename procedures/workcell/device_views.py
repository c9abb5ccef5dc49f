"""The devices as steps, guards and commands may see them, by type: what moves the arm is in none of these."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Protocol, Self

from ronna_hw.devices.lifecycle import Identity, LastKnown, Lifecycle
from ronna_hw.devices.readings import TrackerFrame, Vector3


class DeviceView(Protocol):
    """A device of whatever kind: to open its connection, and to see what it last knew."""

    @property
    def state(self) -> Lifecycle:
        """As `Device.state`."""
        ...

    @property
    def notices(self) -> tuple[str, ...]:
        """As `Device.notices`."""
        ...

    def observe(self) -> LastKnown[object]:
        """As `Device.observe`."""
        ...

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """As `Device.connect`."""
        ...

    def configure(self, timeout_s: float = 10.0) -> None:
        """As `Device.configure`."""
        ...


class StereoView(DeviceView, Protocol):
    """The stereo head: to start it where no arm is started. It looks by `Workcell.look`."""

    @property
    def serials(self) -> tuple[str, str]:
        """As `StereoPair.serials`."""
        ...

    def activate(self, timeout_s: float = 10.0) -> None:
        """As `Device.activate`."""
        ...


class TrackerView(Protocol):
    """The tracker: to measure with it. Its connection is opened as any device's."""

    @property
    def state(self) -> Lifecycle:
        """As `Device.state`."""
        ...

    @property
    def tools(self) -> tuple[str, ...]:
        """As `OpticalTracker.tools`."""
        ...

    @property
    def markers_mm(self) -> Mapping[str, tuple[Vector3, ...]]:
        """As `OpticalTracker.markers_mm`."""
        ...

    def observe(self) -> LastKnown[TrackerFrame]:
        """As `OpticalTracker.observe`."""
        ...

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Self]:
        """As `Device.active`."""
        ...

    def activate(self, timeout_s: float = 10.0) -> None:
        """As `Device.activate`."""
        ...

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """As `Device.deactivate`."""
        ...

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        """As `OpticalTracker.read_frame`."""
        ...
