"""Two jointly triggered GigE Vision cameras as a `StereoPair`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any, TypeVar

from drivers.basler_stereo.camera import Camera, LinkRecorder
from drivers.basler_stereo.errors import CameraLost, CommandRefused, ControlLost, NoReply, ReceiverEnded
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions, read_options
from drivers.basler_stereo.pair_device import PairDevice
from drivers.basler_stereo.pair_grabber import PairGrabber
from drivers.basler_stereo.stream.frame_assembler import StreamCounters
from drivers.basler_stereo.stream.receiver import ReceiverProcess
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import ByteSink, Fact
from ronna_hw.devices.lifecycle import READABLE
from ronna_hw.devices.readings import StereoReading
from ronna_hw.errors import RonnaError
from ronna_hw.wire.gige_vision import GevStatus

_FAULTS = (CameraLost, ControlLost, ReceiverEnded)  # latched; cleared only by `recover`

T = TypeVar("T")


class BaslerStereoPair(PairDevice[Camera]):
    """Pair of GigE Vision cameras with synchronous calls; not thread-safe.

    Time limits are host seconds.

    The driver waits for a silent camera within the time limit and repeats the interrupted work. The camera
    stays under our control until its heartbeat times out, so a short absence only costs time.
    """

    wire_protocol = "gige-vision"  # which byte-level conformance cases apply

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check options and endpoints without opening a connection; raises GEV-016, CFG-001 or CFG-002."""
        super().__init__(name, config, clock, read_options(config, BaslerOptions))
        self._receiver_process: ReceiverProcess | None = None
        self._grabber: PairGrabber | None = None
        self._sink: ByteSink | None = None

    @staticmethod
    def conformance_options() -> dict[str, Any]:
        """Return the options for a conformance run on unknown cameras."""
        return {"expected_model": ""}

    @property
    def notices(self) -> tuple[str, ...]:
        """Messages from `configure` that are not errors but concern the operator."""
        return tuple(notice for camera in self._cameras or () for notice in camera.notices)

    @property
    def counters(self) -> tuple[StreamCounters | None, StreamCounters | None]:
        """Statistics of the current streams, left and right."""
        self._guard.require("counters", READABLE)
        left, right = self._pair
        return left.counters, right.counters

    def readiness(self, timeout_s: float = 1.0) -> tuple[Fact, ...]:
        """Report packet losses of the current streams and camera temperatures.

        Nothing is reported before they start.

        No published temperature limit is known, so it is reported without being judged.
        """
        self._require("readiness", set(READABLE))
        deadline_s = time.monotonic() + timeout_s
        facts: list[Fact] = []
        for side, camera, counters in zip(("left", "right"), self._pair, self.counters, strict=True):
            if counters is None:
                continue
            dropped = f", {counters.foreign} from elsewhere dropped" if counters.foreign else ""
            facts.append(
                Fact(
                    f"packets of the {side} camera",
                    f"{counters.packets} received, {counters.resend_requests} resend requests{dropped}",
                    counters.incomplete_frames == 0,
                    "Use jumbo frames, another cable or port, a larger receive buffer.",
                )
            )
            if (inside_C := camera.read_temperature_C(deadline_s)) is not None:
                facts.append(Fact(f"temperature of the {side} camera", f"{inside_C:.0f} C"))
        return tuple(facts)

    @property
    def block_ids(self) -> tuple[int | None, int | None]:
        """Left and right block ids of the last pair, None for a missing image; each stream restarts them."""
        return self._grabber.block_ids if self._grabber else (None, None)

    def record_bytes(self, sink: ByteSink | None) -> None:
        self._sink = sink

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        """Trigger both cameras, or wait for an external trigger with `line1`, and return the pair.

        A side without an image is None and the reading MISSING, provided its camera replies. Images from
        different triggers are UNPAIRED, two older than the trigger STALE. If neither camera sent an
        image, or the pair is UNPAIRED or STALE, both are triggered once more; raises GEV-013 if there is
        still no image. After an incomplete pair the streams restart, so that a late image is never
        attributed to the next trigger.

        Raises GEV-007 when a camera stays silent until `timeout_s`; then call again. Raises, with FAULT
        latched, GEV-014 (a camera silent beyond its heartbeat time-out), GEV-015 (control lost) or GEV-017
        (our receiver process ended).
        """
        with self._grabbing(timeout_s) as deadline_s:
            return self._run_guarded(lambda: self._grab_reading(deadline_s), deadline_s, keeps_settings=True)

    @property
    def _streams(self) -> PairGrabber:
        assert self._grabber is not None, "the lifecycle allows this call only with controlled cameras"
        return self._grabber

    def _stream_facts(self) -> dict[str, Any]:
        return {"streams": self.counters}

    def _start_streams(self, deadline_s: float) -> None:
        self._streams.start_streams(deadline_s)

    def _stop_streams(self, deadline_s: float) -> None:
        self._streams.stop_streams(deadline_s)

    def _run_guarded(self, work: Callable[[], T], deadline_s: float, *, keeps_settings: bool = False) -> T:
        """Run an operation, repeating it after a silence; latches FAULT if cameras or control are lost.

        A camera that stays silent while its settings change also latches FAULT: they are then unknown.
        """
        try:
            while True:
                for camera in self._pair:
                    if camera.lost is not None:
                        raise camera.lost
                try:
                    return work()
                except NoReply as silence:
                    if time.monotonic() >= deadline_s:
                        raise
                    self._guard.log.warning("a camera is silent: waiting for it", cause=silence)
                    self._streams.await_replies(deadline_s)
        except _FAULTS as fault:
            self._guard.latch(fault)
            raise
        except CommandRefused as error:
            if error.status != GevStatus.ACCESS_DENIED:
                raise
            control_lost = ControlLost("a camera rejects our commands", got=error.what)
            self._guard.latch(control_lost)
            raise control_lost from error
        except NoReply as error:
            if keeps_settings:
                raise
            lost = CameraLost("a camera no longer replies", got=error.what)
            self._guard.latch(lost)
            raise lost from error

    def _open_cameras(
        self, deadline_s: float
    ) -> tuple[tuple[Camera, Camera], tuple[CameraIdentity, CameraIdentity]]:
        left, right = (
            Camera(
                side, self._addresses[side], self._options, LinkRecorder(f"{self._name}.{side}", self._sink)
            )
            for side in ("left", "right")
        )
        return self._identify((left, right), lambda camera: camera.connect(deadline_s))

    def _configure_cameras(self, deadline_s: float) -> None:
        """Take control of both cameras and determine the packet size; an error releases both."""
        configured_cameras: list[Camera] = []
        self._end_receiver_process()
        self._receiver_process = ReceiverProcess()
        try:
            for camera in self._pair:
                camera.notices.clear()
                camera.configure(self._receiver_process, deadline_s)
                configured_cameras.append(camera)
        except BaseException:  # including interruptions: neither cameras nor receiver are left behind
            for camera in configured_cameras:
                with contextlib.suppress(RonnaError, OSError):
                    camera.release(deadline_s)
            self._end_receiver_process()
            raise
        self._grabber = PairGrabber(self._pair, self.serials, self._clock, self._options)

    def _grab_reading(self, deadline_s: float) -> StereoReading:
        reading = self._streams.grab(self._sequence + 1, deadline_s)
        self._sequence += 1
        return self._store_pair(reading)

    def _release_all(self) -> None:
        super()._release_all()
        self._grabber = None
        self._end_receiver_process()

    def _end_receiver_process(self) -> None:
        if self._receiver_process is not None:
            self._receiver_process.close()
        self._receiver_process = None
