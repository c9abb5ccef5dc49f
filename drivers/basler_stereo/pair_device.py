"""Common base of stereo drivers: the cameras, their identities, and the device state."""

from __future__ import annotations

from typing import Generic, Protocol, TypeVar

from drivers.basler_stereo.control.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import counted_fact
from ronna_hw.devices.lifecycle import READABLE, LastKnown, Lifecycle, LifecycleGuard
from ronna_hw.devices.readings import AreaOfInterest, StereoReading, Validity
from ronna_hw.errors import RonnaError


class HasArea(Protocol):
    """A camera that reads part of its sensor."""

    area: AreaOfInterest


C = TypeVar("C", bound=HasArea)


class PairDevice(Generic[C]):
    """The part of a `StereoPair` that is independent of how its cameras are accessed."""

    def __init__(self, name: str, config: DeviceConfig, clock: Clock, options: BaslerOptions) -> None:
        self._name = name
        self._clock = clock
        self._addresses = {side: config.address(side).require("gev").host for side in ("left", "right")}
        self._guard = LifecycleGuard(name)
        self._cameras: tuple[C, C] | None = None
        self._identities: tuple[CameraIdentity, CameraIdentity] | None = None
        self._areas: tuple[AreaOfInterest, AreaOfInterest] | None = None
        self._exposure: tuple[float, int | None] = (options.exposure_us, options.gain_raw)
        self._sequence = 0
        self._last_pair: StereoReading | None = None
        self._unusable = 0

    @property
    def name(self) -> str:
        return self._name

    @property
    def state(self) -> Lifecycle:
        return self._guard.state

    @property
    def fault(self) -> RonnaError | None:
        """What latched FAULT, if anything."""
        return self._guard.fault

    @property
    def serials(self) -> tuple[str, str]:
        """Serial numbers read from the cameras, left and right; empty before `connect`."""
        return (self._identities[0].serial, self._identities[1].serial) if self._identities else ("", "")

    @property
    def areas(self) -> tuple[AreaOfInterest, AreaOfInterest]:
        """The sensor areas that are read, left and right; known from `configure` on."""
        self._guard.require("areas", READABLE)
        left, right = self._pair
        return left.area, right.area

    def observe(self) -> LastKnown[StereoReading]:
        return self._guard.last_known(self._last_pair, counted_fact("unusable pairs", self._unusable))

    def _keep(self, pair: StereoReading) -> StereoReading:
        """Note a new pair for `observe`."""
        self._last_pair = pair
        self._unusable += pair.validity is not Validity.OK
        return pair

    @property
    def _pair(self) -> tuple[C, C]:
        assert self._cameras is not None, "the lifecycle allows this call only with cameras"
        return self._cameras
