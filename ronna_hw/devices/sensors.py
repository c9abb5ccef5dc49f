"""Sensor interfaces: an optical tracker for tools and strays, and a triggered camera pair."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping
from operator import index
from typing import Protocol, runtime_checkable

from ronna_hw.arguments import WrongArgument, show
from ronna_hw.devices.errors import NO_NEW_FRAME
from ronna_hw.devices.lifecycle import Device, LastKnown
from ronna_hw.devices.readings import AreaOfInterest, StereoReading, TrackerFrame, Validity
from ronna_hw.vectors import Vector3


@runtime_checkable
class OpticalTracker(Device, Protocol):
    """Optical tracker.

    `configure` loads and enables the tools of the theatre file; `activate` starts tracking.
    """

    @property
    def tools(self) -> tuple[str, ...]:
        """Names of the tools to load, in theatre file order."""

    @property
    def markers_mm(self) -> Mapping[str, tuple[Vector3, ...]]:
        """Marker positions of each tool by name, in the tool's own frame."""

    def observe(self) -> LastKnown[TrackerFrame]:
        """Same as `Device.observe`; the reading is the last frame."""

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        """Request the next measurement. Allowed in ACTIVE.

        The frame counter of the device is in `stamp.device_clock`; a repeated number means that no new
        measurement was made. Raises LinkTimeout, ProtocolError or DeviceError.
        """


# Cross-sections of a measuring volume, near to far, in the tracker frame: z, half x, half y. Faces are flat
# between two of them.
VolumeSections = tuple[tuple[float, float, float], ...]


@runtime_checkable
class BoundedTracker(Protocol):
    """Tracker that knows its measuring volume."""

    @property
    def volume_sections_mm(self) -> VolumeSections:
        """Cross-sections of the volume: once configured, as the unit reports them.

        Before, and for a unit that does not report them, as published for its model; empty if unknown.
        """


def measuring_volume_mm(tracker: object) -> VolumeSections:
    """Return the cross-sections of a tracker's measuring volume, empty if it does not know them."""
    return tracker.volume_sections_mm if isinstance(tracker, BoundedTracker) else ()


@runtime_checkable
class StatesStrays(Protocol):
    """Tracker that states whether its frames include strays; one that does not state it has them."""

    @property
    def reports_strays(self) -> bool:
        """Whether markers that belong to no tool are reported."""


def reports_strays(tracker: object) -> bool:
    """Return whether a tracker reports markers that belong to no tool, such as single spheres on a head."""
    return tracker.reports_strays if isinstance(tracker, StatesStrays) else True


@runtime_checkable
class TimedTracker(Protocol):
    """Tracker that reports its reply times, the minimum age of a frame on arrival."""

    @property
    def replies_s(self) -> tuple[float, ...]:
        """Request-to-reply times of recent frames, excluding transfer, newest last.

        Host time, or theatre time if that is less: neither a computer that stalls nor a theatre whose time
        runs ahead makes a reply late. From any thread; an earlier run of tracking counts as well.
        """


@runtime_checkable
class StereoPair(Device, Protocol):
    """Pair of cameras triggered together.

    `configure` takes control, binds serial numbers to sides and sets the cameras; `activate` arms them.
    """

    @property
    def serials(self) -> tuple[str, str]:
        """Serial numbers read from the cameras, left and right."""

    def observe(self) -> LastKnown[StereoReading]:
        """Same as `Device.observe`; the reading is the last pair."""

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 5.0) -> None:
        """Set the readout area of each sensor; a running stream is restarted."""

    def set_exposure(self, exposure_us: float, gain_raw: int, timeout_s: float = 5.0) -> None:
        """Set exposure and gain of both cameras; raises LimitError if out of range."""

    def scale_exposure(self, share: float, timeout_s: float = 5.0) -> None:
        """Scale both cameras' last configured or set exposure by `share`; 1.0 restores it."""

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        """Trigger both cameras once and return the resulting pair. Allowed in ACTIVE."""


@runtime_checkable
class ProjectsLine(Protocol):
    """Camera pair whose driver can switch a line projector on the head."""

    @property
    def has_projector(self) -> bool:
        """Whether the theatre file names a projector."""

    @property
    def projector_on(self) -> bool:
        """Whether the projector was last switched on; False once the streams stop or a fault is latched."""

    def set_projector(self, on: bool, timeout_s: float = 5.0) -> None:
        """Switch the line and read it back. Allowed in CONFIGURED and ACTIVE.

        It is off after `configure`, `deactivate`, `recover` and `close`. Raises DeviceError when the output
        does not follow, ConfigurationError without a projector.
        """


def line_projector(pair: object) -> ProjectsLine | None:
    """Return a camera pair as the projector of a line, or None if its head has none."""
    return pair if isinstance(pair, ProjectsLine) and pair.has_projector else None


ASK_AGAIN_S = 0.005  # host time; a tracker measures every 16 ms


def new_frames(
    tracker: OpticalTracker, count: int | None = None, *, timeout_s: float = 1.0
) -> Iterator[TrackerFrame]:
    """Yield `count` new measurements, or endlessly if None, skipping STALE repeats.

    `timeout_s` is host time for each. Raises ARG-001 for no tracker or no count, DEV-009 when the tracker
    delivers no new measurement in time, and the errors of `read_frame`.
    """
    if not hasattr(tracker, "read_frame"):
        raise WrongArgument("this is no tracker", expected="an OpticalTracker", got=show(tracker))
    try:
        wanted = None if count is None else index(count)
    except TypeError:
        wanted = -1
    if wanted is not None and wanted < 0:
        raise WrongArgument(
            "the count of new frames is no count",
            expected="a whole number, not negative, or None for endlessly many",
            got=show(count),
            action="Give the number of frames, such as 60 for one second.",
        )
    counted = itertools.count() if wanted is None else range(wanted)
    return (read_new_frame(tracker, timeout_s) for _ in counted)


def read_new_frame(tracker: OpticalTracker, timeout_s: float = 1.0) -> TrackerFrame:
    """Read the next new measurement. Raises DEV-009, and the errors of `read_frame`."""
    deadline_s = time.monotonic() + timeout_s
    while (remaining_s := deadline_s - time.monotonic()) > 0:
        frame = tracker.read_frame(remaining_s)
        if frame.validity is not Validity.STALE:
            return frame
        time.sleep(ASK_AGAIN_S)
    raise NO_NEW_FRAME(f"{tracker.name} delivers no new measurement", limit=f"{timeout_s:g} s")
