"""Two Basler cameras as a `StereoPair`, through the optional vendor library pypylon.

[stereo]
driver = "basler_pylon"
endpoints = { left = "gev://192.168.3.11", right = "gev://192.168.3.12" }

The options are those of basler_stereo; heartbeat, packets and retransmission are handled by the library.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

from drivers.basler_stereo.errors import CameraLost, TriggerMissed
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions, read_options
from drivers.basler_stereo.pair_device import PairDevice
from drivers.basler_stereo.pylon.camera import PylonCamera, PylonFrame, load_pylon
from drivers.basler_stereo.readings import PairClock, stereo_reading
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, Stamp, StereoReading, Validity

T = TypeVar("T")


class PylonOptions(BaslerOptions):
    """Camera pair options; `device_class` selects real or emulated cameras."""

    device_class: Literal["BaslerGigE", "BaslerCamEmu"] = "BaslerGigE"
    trigger: Literal["software"] = "software"


class PylonStereoPair(PairDevice[PylonCamera]):
    """Pair of pypylon cameras with synchronous calls; not thread-safe.

    Time limits are host seconds.
    """

    wire_protocol = ""  # spoken by the vendor's library

    _options: PylonOptions

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check library, options and endpoints; raises GEV-016, GEV-018, CFG-001 or CFG-002."""
        load_pylon()
        super().__init__(name, config, clock, read_options(config, PylonOptions))
        self._pair_clock = PairClock((None, None), 0.0)
        self._must_restart = False

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        """Trigger both cameras once and return the resulting pair.

        A side without a complete image is None and the reading MISSING. Raises GEV-013 when neither side sent
        one, and, with FAULT latched, GEV-014. After an incomplete pair the streams restart.
        """
        with self._grabbing(timeout_s) as deadline_s:
            return self._store_pair(self._run_guarded(lambda: self._grab_reading(deadline_s), deadline_s))

    def _open_cameras(
        self, deadline_s: float
    ) -> tuple[tuple[PylonCamera, PylonCamera], tuple[CameraIdentity, CameraIdentity]]:
        options = self._options
        left, right = (
            PylonCamera(side, self._addresses[side], serial, options.device_class, options)
            for side, serial in (("left", options.left_serial), ("right", options.right_serial))
        )
        return self._identify((left, right), PylonCamera.connect)

    def _configure_cameras(self, deadline_s: float) -> None:
        for camera in self._pair:
            camera.configure()

    def _run_guarded(self, work: Callable[[], T], deadline_s: float) -> T:
        try:
            return work()
        except CameraLost as fault:
            self._guard.latch(fault)
            raise

    def _start_streams(self, deadline_s: float) -> None:
        for camera in self._pair:
            camera.start()
        self._pair_clock = PairClock((None, None), self._options.pair_skew_ms / 1000.0)
        self._must_restart = False

    def _stop_streams(self, deadline_s: float) -> None:
        for camera in self._pair:
            camera.stop()

    def _grab_reading(self, deadline_s: float) -> StereoReading:
        if self._must_restart:
            self._stop_streams(deadline_s)
            self._start_streams(deadline_s)
        triggered_s = self._clock.now_s()  # before the trigger: an image is never older than its stamp
        for camera in self._pair:
            camera.trigger()
        frames = [camera.take(deadline_s) for camera in self._pair]
        self._must_restart = any(frame is None or frame.pixels is None for frame in frames)
        if not any(frames):
            raise TriggerMissed("no image after a trigger", expected="an image from either camera")
        self._sequence += 1
        left, right = (
            self._make_image(frame, serial, camera.area, triggered_s)
            for frame, serial, camera in zip(frames, self.serials, self._pair, strict=True)
        )
        match = self._match_frames(frames, triggered_s)
        return stereo_reading(left, right, self._sequence, triggered_s, match)

    def _match_frames(self, frames: list[Any], triggered_s: float) -> Validity:
        if self._must_restart:
            return Validity.OK  # the missing side is reported anyway
        left, right = self._pair
        match = self._pair_clock.judge_pair(
            (frames[0].ticks, frames[1].ticks),
            (left.tick_frequency_hz, right.tick_frequency_hz),
            triggered_s,
            self._clock.now_s(),
        )
        self._must_restart = match is not Validity.OK
        return match

    def _make_image(
        self, frame: PylonFrame | None, serial: str, area: AreaOfInterest, triggered_s: float
    ) -> CameraImage | None:
        if frame is None or frame.pixels is None:
            return None
        matches_area = frame.pixels.shape == (area.height, area.width)
        stamp = Stamp(self._sequence, frame.ticks, triggered_s)
        validity = Validity.OK if matches_area else Validity.CORRUPT
        return CameraImage(stamp, validity, serial, frame.pixels, area)
