"""Device readings as frozen records of plain numbers, with units in the field names.

Missing data is expressed by the validity, never as NaN or zeros. Transforms are built from
a reading on demand.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, Protocol, runtime_checkable

from ronna_hw.devices.errors import NO_POSE, UnknownTool
from ronna_hw.vectors import JointVector, Quaternion, Vector3

# The robot's real-time process imports this: NumPy would be a third of its start and of its memory.
if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ronna_hw.frames import Frame, Transform


class Validity(StrEnum):
    """Usability of a reading, with the reason if it is unusable."""

    OK = "ok"
    PARTIAL = "partial"
    MISSING = "missing"
    OUT_OF_VOLUME = "out_of_volume"
    STALE = "stale"
    CORRUPT = "corrupt"
    UNPAIRED = "unpaired"  # left and right image are from different triggers


@dataclass(frozen=True)
class Stamp:
    """Time of a reading: our sequence number, device clock, theatre time."""

    sequence: int
    device_clock: int  # in the device's own unit: tracker frames, IPOC milliseconds, camera ticks
    theatre_time_s: float  # on arrival
    measured_s: float | None = None  # theatre time of the measurement, if the driver knows it


@runtime_checkable
class StampedReading(Protocol):
    """Reading with a time stamp and a validity."""

    @property
    def stamp(self) -> Stamp:
        """Time stamp of the reading."""

    @property
    def validity(self) -> Validity:
        """Usability of the reading."""


_TO_SEE = {
    Validity.MISSING: "Clear the line of sight between the tracker and the markers of the tool.",
    Validity.OUT_OF_VOLUME: "Move the tracker or the tool so that the tool is inside the measuring volume.",
}


@dataclass(frozen=True)
class ToolReading:
    """Pose of a loaded tool in the tracker frame; rotation and position are None if unknown.

    `markers_used` says which markers of its definition the pose was fitted to; None if the tracker does not.
    """

    tool: str
    validity: Validity
    rotation: Quaternion | None  # tracker <- tool
    position_mm: Vector3 | None
    fit_error_mm: float | None  # rms of the fit to the definition; not an accuracy
    markers_used: tuple[bool, ...] | None = None

    def transform(self, target: Frame, source: Frame) -> Transform:
        """Return the pose as `TRACKER <- source`; raises DEV-004 if it is missing or untrustworthy.

        Raises FRM-001 for another target. Outside the measuring volume the tracker's error is not specified:
        use those numbers only for aiming.
        """
        from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform

        if target is not Frame.TRACKER or source is Frame.TRACKER:
            raise FRAME_MISMATCH(
                f"the pose of tool {self.tool} was measured in the tracker frame",
                expected=f"{Frame.TRACKER} <- a frame of the tool",
                got=f"{target} <- {source}",
                action="Use transform(Frame.TRACKER, Frame.MARKER); invert that, or compose it with the pose "
                "of the tracker.",
            )
        if self.rotation is None or self.position_mm is None or self.validity is Validity.OUT_OF_VOLUME:
            raise NO_POSE(
                f"tool {self.tool} has no pose: {self.validity.value}", action=_TO_SEE.get(self.validity)
            )
        return Transform.of(target, source, translation_mm=self.position_mm, quaternion_wxyz=self.rotation)


@dataclass(frozen=True)
class StrayReading:
    """Marker not belonging to any tool; its identity does not persist between frames."""

    position_mm: Vector3
    validity: Validity


@dataclass(frozen=True)
class TrackerFrame:
    """Tools and strays seen by the tracker in one frame."""

    stamp: Stamp
    validity: Validity
    tools: tuple[ToolReading, ...]
    strays: tuple[StrayReading, ...]

    def tool(self, name: str) -> ToolReading:
        """Return the reading of a tool by name; raises DEV-003 for an unknown tool."""
        for reading in self.tools:
            if reading.tool == name:
                return reading
        known = ", ".join(reading.tool for reading in self.tools)
        raise UnknownTool(f"the tracker has no tool {name}", expected=known or "none")


@dataclass(frozen=True)
class ArmReading:
    """Arm state: axes as measured by the controller, and commanded axes."""

    stamp: Stamp
    validity: Validity
    joints_rad: JointVector
    commanded_rad: JointVector | None  # None while no correction stream is running
    moving: bool
    force_N: Vector3 | None = None  # on the tool, in the robot base; None if the arm senses none


@dataclass(frozen=True)
class ToolIdentity:
    """Tool number on the controller's inputs; 0 means no tool."""

    stamp: Stamp
    number: int


@dataclass(frozen=True)
class LinkStatistics:
    """Real-time link statistics since activation, with times in microseconds of host time.

    Its text leaves out the histograms, which are for plots.
    """

    cycles: int
    late_cycles: int
    lost_cycles: int
    rejected_telegrams: int
    turnaround_median_us: float
    turnaround_p99_us: float
    histogram_edges_us: tuple[float, ...] = field(repr=False)
    histogram_counts: tuple[int, ...] = field(repr=False)  # one fewer than the edges
    foreign_telegrams: int = 0  # from any host but the controller; never answered
    jitter_median_us: float = 0.0  # deviation of telegrams from the controller's cycle
    jitter_p99_us: float = 0.0
    jitter_counts: tuple[int, ...] = field(default=(), repr=False)  # over the same edges


@dataclass(frozen=True)
class AreaOfInterest:
    """Readout area of a sensor in pixels; offsets from the top-left pixel."""

    offset_x: int
    offset_y: int
    width: int
    height: int


@dataclass(frozen=True)
class CameraImage:
    """Read-only 2-D array of grey values. (0, 0) is the centre of the top-left pixel."""

    __pydantic_config__: ClassVar = {"arbitrary_types_allowed": True}  # pixels, read back from a tape

    stamp: Stamp
    validity: Validity
    serial: str
    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    area: AreaOfInterest
    missing_packets: int = 0


@dataclass(frozen=True)
class StereoReading:
    """Pair of images from one trigger.

    PARTIAL: packets are missing; MISSING: one side did not arrive; UNPAIRED: left and right are from
    different triggers; STALE: both are older than the trigger.
    """

    stamp: Stamp
    validity: Validity
    left: CameraImage | None
    right: CameraImage | None
