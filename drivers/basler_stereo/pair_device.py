"""Base of stereo drivers: the cameras, their identities, and the device state."""

from __future__ import annotations

from typing import Generic, Protocol, TypeVar

from drivers.basler_stereo.errors import CablesSwapped, WrongModel, WrongSerial
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import counted_fact
from ronna_hw.devices.lifecycle import READABLE, Identity, LastKnown, Lifecycle, LifecycleGuard
from ronna_hw.devices.readings import AreaOfInterest, StereoReading, Validity
from ronna_hw.errors import RonnaError


class HasArea(Protocol):
    """Camera that reads part of its sensor."""

    area: AreaOfInterest


C = TypeVar("C", bound=HasArea)


class PairDevice(Generic[C]):
    """Part of a `StereoPair` that is independent of how its cameras are accessed."""

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
        """The error that latched FAULT, if any."""
        return self._guard.fault

    @property
    def serials(self) -> tuple[str, str]:
        """Serial numbers read from the cameras, left and right; empty before `connect`."""
        return (self._identities[0].serial, self._identities[1].serial) if self._identities else ("", "")

    @property
    def areas(self) -> tuple[AreaOfInterest, AreaOfInterest]:
        """Sensor areas that are read, left and right; known from `configure` on."""
        self._guard.require("areas", READABLE)
        left, right = self._pair
        return left.area, right.area

    def observe(self) -> LastKnown[StereoReading]:
        return self._guard.last_known(self._last_pair, counted_fact("unusable pairs", self._unusable))

    def _keep(self, pair: StereoReading) -> StereoReading:
        """Keep a new pair for `observe`."""
        self._last_pair = pair
        self._unusable += pair.validity is not Validity.OK
        return pair

    @property
    def _pair(self) -> tuple[C, C]:
        assert self._cameras is not None, "the lifecycle allows this call only with cameras"
        return self._cameras


def check_pair(left: CameraIdentity, right: CameraIdentity, options: BaslerOptions) -> None:
    """Raise GEV-002, GEV-003 or GEV-004 unless these are the expected cameras, each on its side."""
    for identity in (left, right):
        if options.expected_model and identity.model != options.expected_model:
            raise WrongModel(
                f"unexpected device at {identity.address}",
                expected=options.expected_model,
                got=f"{identity.vendor} {identity.model}".strip(),
            )
    wanted = (options.left_serial, options.right_serial)
    if left.serial == right.serial:
        raise WrongSerial(f"{left.address} and {right.address} are the same camera", got=left.serial)
    if _matches((left.serial, right.serial), wanted):
        return
    if _matches((right.serial, left.serial), wanted):
        raise CablesSwapped(
            "left and right camera are swapped",
            expected=f"left {wanted[0]}, right {wanted[1]}",
            got=f"left {left.serial}, right {right.serial}",
        )
    for side, identity, serial in (("left", left, wanted[0]), ("right", right, wanted[1])):
        if serial is not None and identity.serial != serial:
            raise WrongSerial(f"unexpected camera on the {side} side", expected=serial, got=identity.serial)


def pair_identity(left: CameraIdentity, right: CameraIdentity) -> Identity:
    """Combine the identities of both cameras into that of one device."""
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
