"""An optical tracker: loaded tools with poses, and stray markers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from ronna_hw.devices.last_known import LastKnown
from ronna_hw.devices.lifecycle import Device
from ronna_hw.devices.readings import TrackerFrame, Vector3


@runtime_checkable
class OpticalTracker(Device, Protocol):
    """`configure` loads and enables the tools of the theatre file; `activate` starts tracking."""

    @property
    def tools(self) -> tuple[str, ...]:
        """Names of the tools to load, in the order of the theatre file."""
        ...

    @property
    def markers_mm(self) -> Mapping[str, tuple[Vector3, ...]]:
        """Marker positions of each tool by name, in the tool's own frame."""
        ...

    def observe(self) -> LastKnown[TrackerFrame]:
        """Like `Device.observe`; the reading is the last frame."""
        ...

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        """The next measurement: one request to the device. Allowed in ACTIVE.

        The frame counter of the device is in `stamp.device_clock`; a repeated number means that no new
        measurement was made. Raises LinkTimeout, ProtocolError or DeviceError.
        """
        ...


@runtime_checkable
class BoundedTracker(Protocol):
    """A tracker that reports its measuring volume."""

    @property
    def volume_sections_mm(self) -> tuple[tuple[float, float, float], ...]:
        """Rectangles perpendicular to its axis, from near to far: z, half x, half y, tracker frame.

        Empty before `configure`, and if the unit does not report it. Faces are flat between two of them.
        """
        ...


@runtime_checkable
class TimedTracker(Protocol):
    """A tracker that reports how long its replies take: how old a frame is at least when it arrives."""

    @property
    def replies_s(self) -> tuple[float, ...]:
        """From request to reply, without the transfer of both, of the last frames, the newest last.

        Host time, or theatre time if that is less: neither a computer that stalls nor a theatre whose time
        runs ahead makes a reply late. From any thread; an earlier run of tracking counts as well.
        """
        ...
