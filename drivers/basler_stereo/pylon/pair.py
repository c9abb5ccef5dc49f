"""Two real Basler cameras through the vendor's library, as a `StereoPair`: an optional extra.

[stereo]
driver = "basler_pylon"
endpoints = { left = "gev://192.168.3.11", right = "gev://192.168.3.12" }

The options are those of basler_stereo; heartbeat, packets and retransmission are handled by the library.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Literal, Self, TypeVar

from pydantic import ValidationError

from drivers.basler_stereo.errors import BadOptions, CameraLost, TriggerMissed, WrongSerial
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.pair_device import PairDevice, check_pair, pair_identity
from drivers.basler_stereo.pylon.camera import PylonCamera, PylonFrame, load_pylon
from drivers.basler_stereo.readings import PairClock, stereo_reading
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import RUNNING, Identity, Lifecycle, activated, require_person
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, Stamp, StereoReading, Validity
from ronna_hw.errors import RonnaError
from ronna_hw.mistakes import describe_mistakes

T = TypeVar("T")


class PylonOptions(BaslerOptions):
    """Options of the pair; `device_class` selects real or emulated cameras."""

    device_class: Literal["BaslerGigE", "BaslerCamEmu"] = "BaslerGigE"
    trigger: Literal["software"] = "software"


class PylonStereoPair(PairDevice[PylonCamera]):
    """Pair of cameras. Calls are synchronous, one thread at a time; time limits are host time, in seconds."""

    wire_protocol = ""  # spoken by the vendor's library
    notices: tuple[str, ...] = ()

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check options, endpoints and the library. Raises GEV-016, GEV-018, CFG-001 or CFG-002."""
        load_pylon()
        try:
            self._options = PylonOptions.model_validate_json(json.dumps(config.options))
        except ValidationError as error:
            raise BadOptions(
                "stereo options: " + "; ".join(describe_mistakes(error, PylonOptions))
            ) from error
        super().__init__(name, config, clock, self._options)
        self._pair_clock = PairClock((None, None), 0.0)
        self._must_restart = False

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Self]:
        return activated(self, timeout_s)

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Find both cameras and check models and serial numbers. Raises GEV-001 to GEV-004."""
        self._guard.require("connect", {Lifecycle.DISCONNECTED})
        identities = self._open()
        identity = pair_identity(*identities)
        self._guard.enter(Lifecycle.CONNECTED, identity=identity)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Take control of both and bring them to a known state; raises GEV-005, GEV-010, GEV-011."""
        self._guard.require("configure", {Lifecycle.CONNECTED})
        for camera in self._pair:
            camera.configure()
        self._guard.enter(Lifecycle.CONFIGURED)

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start both streams; the cameras then wait for triggers."""
        self._guard.require("activate", {Lifecycle.CONFIGURED})
        self._begin()
        self._guard.enter(Lifecycle.ACTIVE)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop both streams; control is kept."""
        self._guard.require("deactivate", RUNNING)
        self._end()
        self._guard.enter(Lifecycle.CONFIGURED)

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 5.0) -> None:
        """Set the part of each sensor to read; on GEV-011 both cameras are unchanged."""
        self._guard.require("set_areas", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        before, running = self.areas, self.state is Lifecycle.ACTIVE
        if running:
            self._end()
        try:
            self._set_areas((left, right))
        except RonnaError:
            self._set_areas(before)
            raise
        finally:
            if running:
                self._begin()
        self._areas = (left, right)

    def set_exposure(self, exposure_us: float, gain_raw: int, timeout_s: float = 5.0) -> None:
        """Set both cameras to the same values; raises GEV-011."""
        self._guard.require("set_exposure", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        for camera in self._pair:
            camera.set_exposure(exposure_us, gain_raw)
        self._exposure = (exposure_us, gain_raw)

    def scale_exposure(self, share: float, timeout_s: float = 5.0) -> None:
        """Multiply the exposure configured or set last by `share`; raises GEV-011."""
        self._guard.require("scale_exposure", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        exposure_us, gain_raw = self._exposure
        for camera in self._pair:
            camera.set_exposure(share * exposure_us, gain_raw)

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        """Trigger both cameras once and return the pair of that trigger.

        A side without a complete image is None and the reading MISSING. Raises GEV-013 when neither side sent
        one, and, with FAULT latched, GEV-014. After an incomplete pair the streams restart.
        """
        self._guard.require("grab_pair", {Lifecycle.ACTIVE})
        return self._keep(self._watched(lambda: self._grab(time.monotonic() + timeout_s)))

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Go from FAULT to CONFIGURED: reconnect to the same cameras, restore areas and exposure."""
        self._guard.require("recover", {Lifecycle.FAULT})
        require_person(acknowledged_by)
        before = self.serials
        self._release_all()
        self._open()
        if self.serials != before:
            raise WrongSerial(
                "different cameras than before", expected="+".join(before), got="+".join(self.serials)
            )
        for camera in self._pair:
            camera.configure()
            camera.set_exposure(*self._exposure)
        self._set_areas(self._areas or self.areas)
        self._guard.enter(Lifecycle.CONFIGURED)

    def close(self) -> None:
        """Release control and close; never raises."""
        if self._guard.state is not Lifecycle.CLOSED:
            self._release_all()
            self._guard.enter(Lifecycle.CLOSED)

    def _open(self) -> tuple[CameraIdentity, CameraIdentity]:
        options = self._options
        left, right = (
            PylonCamera(side, self._addresses[side], serial, options.device_class, options)
            for side, serial in (("left", options.left_serial), ("right", options.right_serial))
        )
        try:
            identities = (left.connect(), right.connect())
            check_pair(*identities, options)
        except BaseException:  # including interruptions: neither camera stays controlled
            left.close()
            right.close()
            raise
        self._cameras, self._identities = (left, right), identities
        return identities

    def _watched(self, work: Callable[[], T]) -> T:
        try:
            return work()
        except CameraLost as fault:
            self._guard.latch(fault)
            raise

    def _begin(self) -> None:
        for camera in self._pair:
            camera.start()
        self._pair_clock = PairClock((None, None), self._options.pair_skew_ms / 1000.0)
        self._must_restart = False

    def _end(self) -> None:
        for camera in self._pair:
            camera.stop()

    def _set_areas(self, areas: tuple[AreaOfInterest, AreaOfInterest]) -> None:
        for camera, area in zip(self._pair, areas, strict=True):
            camera.set_area(area)

    def _grab(self, deadline_s: float) -> StereoReading:
        if self._must_restart:
            self._end()
            self._begin()
        triggered_s = self._clock.now_s()  # before the trigger: an image is never older than its stamp
        for camera in self._pair:
            camera.trigger()
        frames = [camera.take(deadline_s) for camera in self._pair]
        self._must_restart = any(frame is None or frame.pixels is None for frame in frames)
        if not any(frames):
            raise TriggerMissed("no image after a trigger", expected="an image from either camera")
        self._sequence += 1
        left, right = (
            self._image(frame, serial, camera.area, triggered_s)
            for frame, serial, camera in zip(frames, self.serials, self._pair, strict=True)
        )
        match = self._match(frames, triggered_s)
        return stereo_reading(left, right, self._sequence, triggered_s, match)

    def _match(self, frames: list[Any], triggered_s: float) -> Validity:
        if self._must_restart:
            return Validity.OK  # the missing side is reported anyway
        ticks = (frames[0].ticks, frames[1].ticks)
        now_s = self._clock.now_s()
        match = self._pair_clock.judge(ticks, triggered_s, now_s)
        if match is Validity.OK:
            left, right = self._pair
            rates = (left.tick_frequency_hz, right.tick_frequency_hz)
            self._pair_clock.confirm(ticks, rates, triggered_s, now_s)
        else:
            self._must_restart = True
        return match

    def _image(
        self, frame: PylonFrame | None, serial: str, area: AreaOfInterest, triggered_s: float
    ) -> CameraImage | None:
        if frame is None or frame.pixels is None:
            return None
        as_set = frame.pixels.shape == (area.height, area.width)
        stamp = Stamp(self._sequence, frame.ticks, triggered_s)
        validity = Validity.OK if as_set else Validity.CORRUPT
        return CameraImage(stamp, validity, serial, frame.pixels, area)

    def _release_all(self) -> None:
        for camera in self._cameras or ():
            camera.close()
        self._cameras = None
