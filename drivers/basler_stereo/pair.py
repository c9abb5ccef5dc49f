"""Two GigE Vision cameras triggered together, as a `StereoPair`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Self, TypeVar

from drivers.basler_stereo.camera import Camera, LinkBytes
from drivers.basler_stereo.errors import (
    CameraLost,
    CommandRefused,
    ControlLost,
    NoReply,
    ReceiverEnded,
    WrongSerial,
)
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import read_options
from drivers.basler_stereo.pair_device import PairDevice, check_pair, pair_identity
from drivers.basler_stereo.pair_grabber import PairGrabber
from drivers.basler_stereo.stream.frame_assembler import StreamCounters
from drivers.basler_stereo.stream.receiver import ReceiverProcess
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import ByteSink, Fact
from ronna_hw.devices.lifecycle import READABLE, RUNNING, Identity, Lifecycle, activated, require_person
from ronna_hw.devices.readings import AreaOfInterest, StereoReading
from ronna_hw.errors import RonnaError
from ronna_hw.wire.gige_vision import GevStatus

CLOSE_LIMIT_S = 1.0  # per camera, even a dead one
_FAULTS = (CameraLost, ControlLost, ReceiverEnded)  # latched; cleared only by `recover`

T = TypeVar("T")


class BaslerStereoPair(PairDevice[Camera]):
    """Pair of cameras. Calls are synchronous, one thread at a time; time limits are host time, in seconds.

    If a camera falls silent, the driver waits for it within the time limit and repeats the interrupted work:
    it stays under our control until its heartbeat times out, so a short absence only costs time.
    """

    wire_protocol = "gige-vision"  # which byte-level conformance cases apply

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check options and endpoints; open nothing. Raises GEV-016, CFG-001 or CFG-002."""
        self._options = read_options(config)
        super().__init__(name, config, clock, self._options)
        self._receiver_process: ReceiverProcess | None = None
        self._grabber: PairGrabber | None = None
        self._sink: ByteSink | None = None

    @staticmethod
    def conformance_options() -> dict[str, Any]:
        """Options for a conformance run on unknown cameras."""
        return {"expected_model": ""}

    @property
    def notices(self) -> tuple[str, ...]:
        """Observations at `configure` that are not errors but should be known."""
        return tuple(notice for camera in self._cameras or () for notice in camera.notices)

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Self]:
        return activated(self, timeout_s)

    @property
    def counters(self) -> tuple[StreamCounters | None, StreamCounters | None]:
        """Statistics of the present streams, left and right."""
        self._guard.require("counters", READABLE)
        left, right = self._pair
        return left.counters, right.counters

    def readiness(self, timeout_s: float = 1.0) -> tuple[Fact, ...]:
        """Report lost packets of the present streams, and temperatures; empty before they start.

        No published temperature limit is known, so it is reported without being judged.
        """
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
            if (inside_C := camera.temperature_C(deadline_s)) is not None:
                facts.append(Fact(f"temperature of the {side} camera", f"{inside_C:.0f} C"))
        return tuple(facts)

    @property
    def block_ids(self) -> tuple[int | None, int | None]:
        """Block ids of the last pair, None for a missing side. They restart with each stream."""
        return self._grabber.block_ids if self._grabber else (None, None)

    def record_bytes(self, sink: ByteSink | None) -> None:
        self._sink = sink

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Find both cameras and check models and serial numbers; does not take control.

        Raises GEV-001 (no camera), GEV-002 (model), GEV-003 (serial number), GEV-004 (swapped).
        """
        self._guard.require("connect", {Lifecycle.DISCONNECTED})
        self._cameras, self._identities = self._open(time.monotonic() + timeout_s)
        identity = pair_identity(*self._identities)
        self._guard.enter(Lifecycle.CONNECTED, addresses=self._addresses, identity=identity)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Take control of both and bring them to a known state: trigger, full frame, packet size.

        Waits up to `timeout_s` for the heartbeat of a dead controlling client to time out. Raises GEV-005
        when another application is in control, GEV-006 to GEV-012 when configuration fails; then neither
        camera is controlled.
        """
        self._guard.require("configure", {Lifecycle.CONNECTED})
        self._configure_cameras(time.monotonic() + timeout_s)
        self._guard.enter(Lifecycle.CONFIGURED, areas=self.areas, notices=self.notices)

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start both streams; the cameras then wait for triggers."""
        self._guard.require("activate", {Lifecycle.CONFIGURED})
        deadline_s = time.monotonic() + timeout_s
        self._watched(lambda: self._streams.begin(deadline_s), deadline_s)
        self._guard.enter(Lifecycle.ACTIVE)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop both streams; control is kept."""
        self._guard.require("deactivate", RUNNING)
        deadline_s = time.monotonic() + timeout_s
        counters = self.counters
        self._watched(lambda: self._streams.end(deadline_s), deadline_s)
        self._guard.enter(Lifecycle.CONFIGURED, streams=counters)

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 5.0) -> None:
        """Set the part of each sensor to read; on GEV-011 both cameras are unchanged.

        A running stream is stopped and restarted; its block ids restart.
        """
        self._guard.require("set_areas", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        if (left, right) == self.areas:
            return
        deadline_s = time.monotonic() + timeout_s
        self._watched(lambda: self._change_areas((left, right), deadline_s), deadline_s)
        self._areas = (left, right)

    def set_exposure(self, exposure_us: float, gain_raw: int, timeout_s: float = 5.0) -> None:
        """Set both cameras to the same values; raises GEV-011."""
        self._guard.require("set_exposure", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        self._expose(exposure_us, gain_raw, timeout_s)
        self._exposure = (exposure_us, gain_raw)

    def scale_exposure(self, share: float, timeout_s: float = 5.0) -> None:
        """Multiply the exposure configured or set last by `share`; raises GEV-011."""
        self._guard.require("scale_exposure", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        exposure_us, gain_raw = self._exposure
        self._expose(share * exposure_us, gain_raw, timeout_s)

    def _expose(self, exposure_us: float, gain_raw: int | None, timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s

        def change() -> None:
            for camera in self._pair:
                camera.set_exposure(exposure_us, gain_raw, deadline_s)

        self._watched(change, deadline_s)
        self._streams.exposure_us = exposure_us

    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        """Trigger both cameras once and return that pair; with trigger `line1`, wait for one.

        A side without an image is None and the reading MISSING, provided its camera replies. Images from
        different triggers are UNPAIRED, two older than the trigger STALE. If neither camera sent an
        image, or the pair is UNPAIRED or STALE, both are triggered once more; raises GEV-013 if there is
        still no image. After an incomplete pair the streams restart, so that a late image is never
        attributed to the next trigger.

        Raises GEV-007 when a camera stays silent until `timeout_s`; then call again. Raises, with FAULT
        latched, GEV-014 (a camera silent beyond its heartbeat time-out), GEV-015 (control lost) or GEV-017
        (our receiver process ended).
        """
        self._guard.require("grab_pair", {Lifecycle.ACTIVE})
        deadline_s = time.monotonic() + timeout_s
        return self._watched(lambda: self._grab(deadline_s), deadline_s, leaves_settings=True)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Go from FAULT to CONFIGURED: reconnect to the same cameras, restore areas and exposure.

        Raises GEV-003 when they are different cameras; FAULT then stays latched.
        """
        self._guard.require("recover", {Lifecycle.FAULT})
        require_person(acknowledged_by)
        before = self.serials
        deadline_s = time.monotonic() + timeout_s
        self._release_all()
        cameras, identities = self._open(deadline_s)
        found = (identities[0].serial, identities[1].serial)
        if found != before:
            _close_all(cameras)
            raise WrongSerial("different cameras than before", expected="+".join(before), got="+".join(found))
        self._cameras, self._identities = cameras, identities
        self._configure_cameras(deadline_s)
        self._restore(deadline_s)
        self._guard.enter(Lifecycle.CONFIGURED)

    def close(self) -> None:
        """Stop, release control and close; about three seconds at most with dead cameras. Never raises."""
        if self._guard.state is Lifecycle.CLOSED:
            return
        self._release_all()
        self._guard.enter(Lifecycle.CLOSED)

    @property
    def _streams(self) -> PairGrabber:
        assert self._grabber is not None, "the lifecycle allows this call only with controlled cameras"
        return self._grabber

    def _watched(self, work: Callable[[], T], deadline_s: float, *, leaves_settings: bool = False) -> T:
        """Do one piece of work, again after a silence; latch FAULT for lost cameras or control.

        So does a camera that stays silent while its settings are changed, since they are then unknown.
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
            taken = ControlLost("a camera rejects our commands", got=error.what)
            self._guard.latch(taken)
            raise taken from error
        except NoReply as error:
            if leaves_settings:
                raise
            lost = CameraLost("a camera no longer replies", got=error.what)
            self._guard.latch(lost)
            raise lost from error

    def _open(self, deadline_s: float) -> tuple[tuple[Camera, Camera], tuple[CameraIdentity, CameraIdentity]]:
        left, right = (
            Camera(side, self._addresses[side], self._options, LinkBytes(f"{self._name}.{side}", self._sink))
            for side in ("left", "right")
        )
        try:
            identities = (left.connect(deadline_s), right.connect(deadline_s))
            check_pair(*identities, self._options)
        except BaseException:  # including interruptions: neither camera stays controlled
            _close_all((left, right))
            raise
        return (left, right), identities

    def _configure_cameras(self, deadline_s: float) -> None:
        done: list[Camera] = []
        self._end_receiver_process()
        self._receiver_process = ReceiverProcess()
        try:
            for camera in self._pair:
                camera.notices.clear()
                camera.configure(self._receiver_process, deadline_s)
                done.append(camera)
        except BaseException:  # including interruptions: neither cameras nor receiver are left behind
            for camera in done:
                with contextlib.suppress(RonnaError, OSError):
                    camera.release(deadline_s)
            self._end_receiver_process()
            raise
        self._grabber = PairGrabber(self._pair, self.serials, self._clock, self._options)

    def _restore(self, deadline_s: float) -> None:
        for camera, area in zip(self._pair, self._areas or (), strict=False):
            camera.set_area(area, deadline_s)
        for camera in self._pair:
            camera.set_exposure(*self._exposure, deadline_s)
        self._streams.exposure_us = self._exposure[0]

    def _change_areas(self, areas: tuple[AreaOfInterest, AreaOfInterest], deadline_s: float) -> None:
        running = self._guard.state is Lifecycle.ACTIVE
        before = self.areas
        if running:
            self._streams.end(deadline_s)
        try:
            for camera, area in zip(self._pair, areas, strict=True):
                camera.set_area(area, deadline_s)
        except NoReply:
            raise  # the camera can no longer be queried
        except RonnaError:
            for camera, area in zip(self._pair, before, strict=True):
                camera.set_area(area, deadline_s)
            if running:
                self._streams.begin(deadline_s)
            raise
        if running:
            self._streams.begin(deadline_s)

    def _grab(self, deadline_s: float) -> StereoReading:
        reading = self._streams.grab(self._sequence + 1, deadline_s)
        self._sequence += 1
        return self._keep(reading)

    def _release_all(self) -> None:
        if self._cameras is not None:
            _close_all(self._cameras)
        self._cameras = self._grabber = None
        self._end_receiver_process()

    def _end_receiver_process(self) -> None:
        if self._receiver_process is not None:
            self._receiver_process.close()
        self._receiver_process = None


def _close_all(cameras: tuple[Camera, Camera]) -> None:
    for camera in cameras:
        camera.close(time.monotonic() + CLOSE_LIMIT_S)
