"""Two cameras that are triggered together."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from ronna_hw.devices.last_known import LastKnown
from ronna_hw.devices.lifecycle import Device
from ronna_hw.devices.readings import AreaOfInterest, StereoReading


@runtime_checkable
class StereoPair(Device, Protocol):
    """`configure` takes control, binds serial numbers to sides and sets the cameras; `activate` arms them."""

    @property
    def serials(self) -> tuple[str, str]:
        """Serial numbers read from the cameras, left and right."""
        ...

    def observe(self) -> LastKnown[StereoReading]:
        """Like `Device.observe`; the reading is the last pair."""
        ...

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 5.0) -> None:
        """Set the area of interest of each sensor; a running stream is restarted."""
        ...

    def set_exposure(self, exposure_us: float, gain_raw: int, timeout_s: float = 5.0) -> None:
        """Set exposure and gain of both cameras; raises LimitError for values outside their limits."""
        ...

    def scale_exposure(self, share: float, timeout_s: float = 5.0) -> None:
        """Multiply the exposure configured or set last by `share` on both cameras; 1.0 restores it."""
        ...

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        """Trigger both cameras once and return the pair of that trigger. Allowed in ACTIVE."""
        ...
