"""Base class of stereo drivers: cameras, identities and lifecycle."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, Protocol, TypeVar

from drivers.basler_stereo.errors import CABLES_SWAPPED, NO_PROJECTOR, WRONG_MODEL, WRONG_SERIAL, NoReply
from drivers.basler_stereo.identity import CameraIdentity, describe_cameras_near
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.arguments import WrongArgument, require_number, require_time_s, show
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import report_count
from ronna_hw.devices.lifecycle import (
    READABLE,
    RUNNING,
    GuardedDevice,
    Identity,
    LastKnown,
    Lifecycle,
    LifecycleGuard,
    require_person,
)
from ronna_hw.devices.reading_stream import ReadingStream, Turn
from ronna_hw.devices.readings import AreaOfInterest, StereoReading, Validity
from ronna_hw.errors import ConnectError, RonnaError, is_error

CLOSE_LIMIT_S = 1.0  # per camera, even a dead one


class PairCamera(Protocol):
    """Left or right camera of a pair; deadlines are host monotonic time."""

    area: AreaOfInterest

    def set_area(self, area: AreaOfInterest, deadline_s: float) -> None: ...

    def set_exposure(self, exposure_us: float, gain_raw: int | None, deadline_s: float) -> None: ...

    def switch_projector(self, on: bool, deadline_s: float) -> None: ...

    def close(self, deadline_s: float) -> None: ...


C = TypeVar("C", bound=PairCamera)
T = TypeVar("T")


class PairDevice(GuardedDevice, ABC, Generic[C]):
    """Base class for `StereoPair` drivers, independent of camera access."""

    wire_protocol: str

    def __init__(self, name: str, config: DeviceConfig, clock: Clock, options: BaslerOptions) -> None:
        super().__init__(name, LifecycleGuard(name))
        self._clock = clock
        self._addresses = {side: config.address(side).require("gev").host for side in ("left", "right")}
        self._options = options
        self._turn = Turn(name)
        self._cameras: tuple[C, C] | None = None
        self._identities: tuple[CameraIdentity, CameraIdentity] | None = None
        self._areas: tuple[AreaOfInterest, AreaOfInterest] | None = None
        self._exposure: tuple[float, int | None] = (options.exposure_us, options.gain_raw)
        self._projector_on = False
        self._sequence = 0
        self._last_pair: StereoReading | None = None
        self._unusable_count = 0

    @property
    def notices(self) -> tuple[str, ...]:
        return ()

    @property
    def serials(self) -> tuple[str, str]:
        """Left and right serial numbers as read from the cameras; empty before `connect`."""
        return (self._identities[0].serial, self._identities[1].serial) if self._identities else ("", "")

    @property
    def areas(self) -> tuple[AreaOfInterest, AreaOfInterest]:
        """Left and right readout areas; available after `configure`."""
        self._guard.require("areas", READABLE)
        left, right = self._pair
        return left.area, right.area

    @property
    def has_projector(self) -> bool:
        """Whether the theatre file names a line projector."""
        return self._options.projector is not None

    @property
    def projector_on(self) -> bool:
        """Whether the line projector was last switched on and still is, as far as is known."""
        return self._projector_on and self._guard.state in (Lifecycle.CONFIGURED, Lifecycle.ACTIVE)

    def observe(self) -> LastKnown[StereoReading]:
        return self._guard.last_known(self._last_pair, report_count("unusable pairs", self._unusable_count))

    @abstractmethod
    def grab_pair(self, timeout_s: float = 5.0) -> StereoReading:
        """Trigger both cameras once and return the pair."""

    def stream(self, *, every: bool = False, timeout_s: float = 5.0) -> ReadingStream[StereoReading]:
        """Trigger and stream pairs, one after the other. Until the stream ends, other calls are refused."""
        return ReadingStream(self.grab_pair, every=every, timeout_s=timeout_s, turn=self._turn)

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Find both cameras and check models and serial numbers, without taking control.

        Raises GEV-001 (no camera), GEV-002 (model), GEV-003 (serial number), GEV-004 (swapped).
        """
        self._guard.require("connect", {Lifecycle.DISCONNECTED})
        self._cameras, self._identities = self._open_cameras(time.monotonic() + timeout_s)
        identity = pair_identity(*self._identities)
        self._guard.enter(Lifecycle.CONNECTED, addresses=self._addresses, identity=identity)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Take control of both cameras and apply a known state: trigger, full frame, packet size.

        May wait until the heartbeat of a dead controlling client has timed out. Raises GEV-005 when another
        application is in control, GEV-006 to GEV-012 when configuration fails.
        """
        self._turn.require("configure")
        self._guard.require("configure", {Lifecycle.CONNECTED})
        self._configure_cameras(time.monotonic() + timeout_s)
        self._projector_on = False
        self._guard.enter(Lifecycle.CONFIGURED, areas=self.areas, notices=self.notices)

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start both streams; the cameras then wait for triggers."""
        self._turn.require("activate")
        self._guard.require("activate", {Lifecycle.CONFIGURED})
        deadline_s = time.monotonic() + timeout_s
        self._run_guarded(lambda: self._start_streams(deadline_s), deadline_s)
        self._guard.enter(Lifecycle.ACTIVE)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop both cameras' streams but keep control of them; ends a stream of readings."""
        self._guard.require("deactivate", RUNNING)
        self._turn.end_stream()
        deadline_s = time.monotonic() + timeout_s
        facts = self._stream_facts()
        self._run_guarded(lambda: self._stop_streams(deadline_s), deadline_s)
        if self._projector_on:
            self._switch_projector(False, deadline_s)
        self._guard.enter(Lifecycle.CONFIGURED, **facts)

    def set_areas(self, left: AreaOfInterest, right: AreaOfInterest, timeout_s: float = 5.0) -> None:
        """Set both readout areas; GEV-011 leaves both cameras unchanged.

        A running stream is stopped and restarted; its block ids restart.
        """
        self._require("set_areas", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        for area in (left, right):
            if not isinstance(area, AreaOfInterest):
                raise WrongArgument("a readout area", expected="an AreaOfInterest", got=show(area))
        if (left, right) == self.areas:
            return
        deadline_s = time.monotonic() + timeout_s
        self._run_guarded(lambda: self._change_areas((left, right), deadline_s), deadline_s)
        self._areas = (left, right)

    def set_exposure(self, exposure_us: float, gain_raw: int, timeout_s: float = 5.0) -> None:
        """Set exposure and gain of both cameras to the same values; raises GEV-011."""
        self._require("set_exposure", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        require_number(exposure_us, "the exposure in us")
        require_number(gain_raw, "the raw gain")
        self._set_exposure(exposure_us, gain_raw, time.monotonic() + timeout_s)
        self._exposure = (exposure_us, gain_raw)

    def scale_exposure(self, share: float, timeout_s: float = 5.0) -> None:
        """Scale the exposure from `configure` or the last `set_exposure` by `share`; raises GEV-011."""
        self._require("scale_exposure", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        require_number(share, "the share of the exposure")
        exposure_us, gain_raw = self._exposure
        self._set_exposure(share * exposure_us, gain_raw, time.monotonic() + timeout_s)

    def set_projector(self, on: bool, timeout_s: float = 5.0) -> None:
        """Switch the line projector and read its line back.

        Raises GEV-019 without a projector, GEV-021 if the line does not follow.
        """
        self._require("set_projector", {Lifecycle.CONFIGURED, Lifecycle.ACTIVE})
        if not self.has_projector:
            raise NO_PROJECTOR(f"{self._name} has no line projector")
        self._switch_projector(on, time.monotonic() + timeout_s)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Return from FAULT to CONFIGURED: reconnect to the same cameras, restore areas and exposure.

        Raises GEV-003 when they are different cameras; FAULT then stays latched.
        """
        self._guard.require("recover", {Lifecycle.FAULT})
        require_person(acknowledged_by)
        before = self.serials
        deadline_s = time.monotonic() + timeout_s
        self._release_all()
        cameras, identities = self._open_cameras(deadline_s)
        if (found := (identities[0].serial, identities[1].serial)) != before:
            self._close_all(cameras)
            raise WRONG_SERIAL(
                "different cameras than before", expected="+".join(before), got="+".join(found)
            )
        self._cameras, self._identities = cameras, identities
        self._configure_cameras(deadline_s)
        self._projector_on = False
        for camera, area in zip(cameras, self._areas or (), strict=False):
            camera.set_area(area, deadline_s)
        for camera in cameras:
            camera.set_exposure(*self._exposure, deadline_s)
        self._guard.enter(Lifecycle.CONFIGURED)

    def close(self) -> None:
        """Stop the streams, release control and close the connections.

        Takes three seconds at most with unresponsive cameras; never raises.
        """
        if self._guard.state is not Lifecycle.CLOSED:
            self._turn.end_stream()
            self._release_all()
            self._guard.enter(Lifecycle.CLOSED)

    @abstractmethod
    def _open_cameras(self, deadline_s: float) -> tuple[tuple[C, C], tuple[CameraIdentity, CameraIdentity]]:
        """Connect to both cameras and verify their identities; an error closes both."""

    @abstractmethod
    def _configure_cameras(self, deadline_s: float) -> None:
        """Take control of both cameras and apply the known state."""

    @abstractmethod
    def _start_streams(self, deadline_s: float) -> None:
        """Start both streams."""

    @abstractmethod
    def _stop_streams(self, deadline_s: float) -> None:
        """Stop both streams."""

    @abstractmethod
    def _run_guarded(self, work: Callable[[], T], deadline_s: float) -> T:
        """Run an operation; latches FAULT if cameras or control are lost."""

    def _require(self, call: str, allowed: set[Lifecycle]) -> None:
        """Raise DEV-001 in another state, and DEV-014 while a stream of readings uses the cameras."""
        self._guard.require(call, allowed)
        self._turn.require(call)

    @contextmanager
    def _grabbing(self, timeout_s: float) -> Iterator[float]:
        """Grab in a block, until the deadline that it gets. Raises DEV-001, DEV-014, ARG-001 for no time."""
        self._require("grab_pair", {Lifecycle.ACTIVE})
        deadline_s = time.monotonic() + require_time_s(timeout_s, "timeout_s")
        with self._turn.call("grab_pair"):
            yield deadline_s

    def _stream_facts(self) -> dict[str, Any]:
        """Return stream statistics for the log entry of `deactivate`."""
        return {}

    def _identify(
        self, cameras: tuple[C, C], connect: Callable[[C], CameraIdentity]
    ) -> tuple[tuple[C, C], tuple[CameraIdentity, CameraIdentity]]:
        """Connect to both cameras and verify their identities; an error closes both."""
        left, right = cameras
        try:
            identities = connect(left), connect(right)
            self._check_found(*identities)
        except BaseException:  # including interruptions: neither camera stays controlled
            self._close_all(cameras)
            raise
        return cameras, identities

    def _check_found(self, left: CameraIdentity, right: CameraIdentity) -> None:
        """Raise the errors of `check_pair`, with the cameras that reply on the same network."""
        try:
            check_pair(left, right, self._options)
        except ConnectError as error:
            if is_error(error, CABLES_SWAPPED):  # both are known
                raise
            wanted = self._options.left_serial, self._options.right_serial
            near = describe_cameras_near(left.address, wanted)
            raise error.reworded(error.what, expected=error.expected, got=f"{error.got}; {near}") from error

    def _release_all(self) -> None:
        if self._cameras is not None:
            self._close_all(self._cameras)
        self._cameras = None

    @staticmethod
    def _close_all(cameras: tuple[C, C]) -> None:
        for camera in cameras:
            camera.close(time.monotonic() + CLOSE_LIMIT_S)

    def _switch_projector(self, on: bool, deadline_s: float) -> None:
        def switch() -> None:
            for camera in self._pair:
                camera.switch_projector(on, deadline_s)

        self._projector_on = on  # also if it fails: `deactivate` then tries again to switch it off
        self._run_guarded(switch, deadline_s)

    def _set_exposure(self, exposure_us: float, gain_raw: int | None, deadline_s: float) -> None:
        def change() -> None:
            for camera in self._pair:
                camera.set_exposure(exposure_us, gain_raw, deadline_s)

        self._run_guarded(change, deadline_s)

    def _change_areas(self, areas: tuple[AreaOfInterest, AreaOfInterest], deadline_s: float) -> None:
        running = self._guard.state is Lifecycle.ACTIVE
        before = self.areas
        if running:
            self._stop_streams(deadline_s)
        try:
            for camera, area in zip(self._pair, areas, strict=True):
                camera.set_area(area, deadline_s)
        except NoReply:
            raise  # the camera can no longer be queried
        except RonnaError:
            for camera, area in zip(self._pair, before, strict=True):
                camera.set_area(area, deadline_s)
            if running:
                self._start_streams(deadline_s)
            raise
        if running:
            self._start_streams(deadline_s)

    def _store_pair(self, pair: StereoReading) -> StereoReading:
        """Store a new pair for `observe`."""
        self._last_pair = pair
        self._unusable_count += pair.validity is not Validity.OK
        return pair

    @property
    def _pair(self) -> tuple[C, C]:
        assert self._cameras is not None, "the lifecycle allows this call only with cameras"
        return self._cameras


def check_pair(left: CameraIdentity, right: CameraIdentity, options: BaslerOptions) -> None:
    """Raise GEV-002, GEV-003 or GEV-004 unless each camera is the expected one for its side."""
    for identity in (left, right):
        if options.expected_model and identity.model != options.expected_model:
            raise WRONG_MODEL(
                f"unexpected device at {identity.address}",
                expected=options.expected_model,
                got=f"{identity.vendor} {identity}".strip(),
            )
    wanted = (options.left_serial, options.right_serial)
    if left.serial == right.serial:
        raise WRONG_SERIAL(f"{left.address} and {right.address} are the same camera", got=str(left))
    if _matches((left.serial, right.serial), wanted):
        if left.info and right.info and left.info != right.info:  # whatever their serial numbers
            raise WRONG_SERIAL(
                "the two cameras belong to different owners, by the information that they give",
                expected="both cameras of one head",
                got=f"left {left}, right {right}",
                action="Give the addresses of one head in the theatre file.",
            )
        return
    if _matches((right.serial, left.serial), wanted):
        raise CABLES_SWAPPED(
            "left and right camera are swapped",
            expected=f"left {wanted[0]}, right {wanted[1]}",
            got=f"left {left.serial}, right {right.serial}",
        )
    for side, identity, serial in (("left", left, wanted[0]), ("right", right, wanted[1])):
        if serial is not None and identity.serial != serial:
            raise WRONG_SERIAL(f"unexpected camera on the {side} side", expected=serial, got=str(identity))


def pair_identity(left: CameraIdentity, right: CameraIdentity) -> Identity:
    """Combine the identities of both cameras into one device identity."""
    return Identity(
        vendor=left.vendor,
        model=left.model,
        serial=f"{left.serial}+{right.serial}",
        firmware=left.version,
        details=(
            ("left", f"{left.serial} {left.mac} {left.address} {left.version}"),
            ("right", f"{right.serial} {right.mac} {right.address} {right.version}"),
        ),
    )


def _matches(serials: tuple[str, str], wanted: tuple[str | None, str | None]) -> bool:
    return all(want is None or serial == want for serial, want in zip(serials, wanted, strict=True))
