"""A well-behaved stereo pair that exists only in the tests: no wire, images of a ramp."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from ideal_device import IdealDevice

from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, Stamp, StereoReading, Validity
from ronna_hw.errors import ConnectError, LimitError

LEFT, RIGHT = "gev://127.0.0.1", "gev://127.0.0.2"
FULL = AreaOfInterest(0, 0, 128, 96)
LONGEST_EXPOSURE_US = 1e6


class Nobody(ConnectError):
    """Nothing is at the address."""

    code = "TST-001"
    action = "Look for it."


@dataclass
class Rig:
    """What two cameras know whoever talks to them: serial numbers by address, controller, ticks."""

    serials: dict[str, str] = field(default_factory=lambda: {LEFT: "1", RIGHT: "2"})
    owner: object = None
    ticks: int = 0


class IdealPair(IdealDevice):
    """Does what the interface says. A subclass holds the rig."""

    rig: ClassVar[Rig]

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        super().__init__(name, config, clock, known={"left_serial", "right_serial"})
        self.serials = ("", "")
        self.areas = (FULL, FULL)
        self.count = 0
        self.has_projector, self.projector_on = True, False

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.guard.require("connect", {Lifecycle.DISCONNECTED})
        sides = [self.config.endpoints[side] for side in ("left", "right")]
        if not set(sides) <= set(self.rig.serials):
            raise Nobody("nobody is there")
        left, right = (self.rig.serials[side] for side in sides)
        bound = [self.config.options.get(f"{side}_serial") for side in ("left", "right")]
        if any(want not in (None, found) for want, found in zip(bound, (left, right), strict=True)):
            raise ConnectError("other cameras")
        self.serials = (left, right)
        self.guard.enter(Lifecycle.CONNECTED)
        return Identity("Test", "Ideal", f"{left}+{right}", "0")

    def configure(self, timeout_s: float = 10.0) -> None:
        self.guard.require("configure", {Lifecycle.CONNECTED})
        if self.rig.owner not in (None, self):
            raise ConnectError("another controller")
        self.rig.owner = self
        super().configure()

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 5.0) -> None:
        self.guard.require("set_areas", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        for area in (left, right):
            if area.offset_x + area.width > FULL.width or area.offset_y + area.height > FULL.height:
                raise LimitError("beyond the sensor")
        self.areas = (left, right)

    def set_exposure(self, exposure_us: float, gain_raw: int, timeout_s: float = 5.0) -> None:
        if not 0.0 < exposure_us <= LONGEST_EXPOSURE_US:
            raise LimitError("no such exposure")

    def scale_exposure(self, share: float, timeout_s: float = 5.0) -> None:
        if share <= 0.0:
            raise LimitError("no such exposure")

    def set_projector(self, on: bool, timeout_s: float = 5.0) -> None:
        self.guard.require("set_projector", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        self.projector_on = on

    def deactivate(self, timeout_s: float = 5.0) -> None:
        super().deactivate()
        self.projector_on = False

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        self.guard.require("grab_pair", {Lifecycle.ACTIVE})
        self.count += 1
        self.rig.ticks += 1
        stamp = Stamp(self.count, self.rig.ticks, self.clock.now_s())
        left, right = (
            image(stamp, serial, area) for serial, area in zip(self.serials, self.areas, strict=True)
        )
        self.newest = StereoReading(stamp, Validity.OK, left, right)
        return self.newest

    def close(self) -> None:
        if self.rig.owner is self:
            self.rig.owner = None
        super().close()


def image(stamp: Stamp, serial: str, area: AreaOfInterest) -> CameraImage:
    """A ramp along the rows, read-only."""
    pixels = np.tile(np.arange(area.width, dtype=np.uint8), (area.height, 1))
    pixels.flags.writeable = False
    return CameraImage(stamp, Validity.OK, serial, pixels, area)


def altered(reading: StereoReading, **changes: object) -> StereoReading:
    """The reading with both images changed alike."""
    assert reading.left is not None
    assert reading.right is not None
    left, right = (replace(side, **changes) for side in (reading.left, reading.right))  # type: ignore[arg-type]
    return replace(reading, left=left, right=right)
