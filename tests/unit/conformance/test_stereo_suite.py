"""The stereo suite passes a good driver of any protocol and finds each mistake by its own case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from ideal_pair import LEFT, RIGHT, IdealPair, Rig, altered

from conformance import device_under_test, stereo
from conformance.case import OUTPUT, CaseOutcome
from conformance.device_under_test import DeviceUnderTest
from conformance.report import run_case
from conformance.target import build_device_under_test
from ronna_hw import registry
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import StereoReading
from ronna_hw.errors import StateError

MakeDut = Callable[..., DeviceUnderTest]


@pytest.fixture
def make_dut(monkeypatch: pytest.MonkeyPatch) -> MakeDut:
    """The device under test for an ideal pair, some of whose members are replaced."""

    def make(**members: Any) -> DeviceUnderTest:
        driver = type("Spoilt", (IdealPair,), {"rig": Rig(), **members})
        for module in (device_under_test, registry):
            monkeypatch.setattr(module, "make_device", driver)
        config = DeviceConfig(driver="test", endpoints={"left": LEFT, "right": RIGHT})
        return build_device_under_test("stereo", config, HostClock(), frozenset({OUTPUT.name}))

    return make


def outcomes(dut: DeviceUnderTest) -> dict[str, CaseOutcome]:
    return {case.number: run_case(case, dut).outcome for case in stereo.SUITE.cases}


def test_a_good_pair_passes_every_case(make_dut: MakeDut) -> None:
    assert set(outcomes(make_dut()).values()) == {CaseOutcome.PASS}


def nothing(self: IdealPair, *arguments: Any) -> None:
    return None


def spoilt_pair(change: Callable[[StereoReading], StereoReading]) -> Callable[..., StereoReading]:
    def grab_pair(self: IdealPair, timeout_s: float = 5.0) -> StereoReading:
        return change(IdealPair.grab_pair(self, timeout_s))

    return grab_pair


def swapped(reading: StereoReading) -> StereoReading:
    return replace(reading, left=reading.right, right=reading.left)


def counted_by_two(reading: StereoReading) -> StereoReading:
    return replace(reading, stamp=replace(reading.stamp, sequence=2 * reading.stamp.sequence))


def writeable(reading: StereoReading) -> StereoReading:
    assert reading.left is not None
    return altered(reading, pixels=reading.left.pixels.copy())


def thirteen_bits(reading: StereoReading) -> StereoReading:
    assert reading.left is not None
    pixels = reading.left.pixels.astype("u2") + 4096
    pixels.flags.writeable = False
    return altered(reading, pixels=pixels)


def still_clock(reading: StereoReading) -> StereoReading:
    return altered(reading, stamp=replace(reading.stamp, device_clock=7))


def unchecked_areas(self: IdealPair, left: Any, right: Any, timeout_s: float = 5.0) -> None:
    self.areas = (left, right)


def starts_once(self: IdealPair, timeout_s: float = 10.0) -> None:
    if self.rig.ticks:
        raise StateError("not again")
    self.rig.ticks += 1
    IdealPair.activate(self)


def takes_control(self: IdealPair, timeout_s: float = 10.0) -> None:
    self.rig.owner = None
    IdealPair.configure(self)


def binds_nothing(self: IdealPair, timeout_s: float = 10.0) -> Identity:
    self.config = self.config.model_copy(update={"options": {}})
    return IdealPair.connect(self)


def finds_anybody(self: IdealPair, timeout_s: float = 10.0) -> Identity:
    self.serials = ("1", "2")
    self.guard.enter(Lifecycle.CONNECTED)
    return Identity("Test", "Ideal", "1+2", "0")


def keeps_control(self: IdealPair) -> None:
    self.guard.enter(Lifecycle.CLOSED)


MISTAKES: dict[str, tuple[str, dict[str, Any]]] = {
    "no set_areas": ("S01", {"set_areas": None}),
    "one serial number": (
        "S02",
        {"connect": lambda self, timeout_s=1.0: replace(IdealPair.connect(self), serial="1")},
    ),
    "configures before connect": ("S03", {"configure": nothing}),
    "sides swapped": ("S04", {"grab_pair": spoilt_pair(swapped)}),
    "counts by two": ("S05", {"grab_pair": spoilt_pair(counted_by_two)}),
    "a clock that stands still": ("S05", {"grab_pair": spoilt_pair(still_clock)}),
    "pixels that can be changed": ("S06", {"grab_pair": spoilt_pair(writeable)}),
    "13 bits": ("S06", {"grab_pair": spoilt_pair(thirteen_bits)}),
    "areas ignored": ("S07", {"set_areas": nothing}),
    "areas unchecked": ("S08", {"set_areas": unchecked_areas}),
    "exposures unchecked": ("S09", {"set_exposure": nothing}),
    "starts once": ("S10", {"activate": starts_once}),
    "takes control from others": ("S11", {"configure": takes_control}),
    "binds no serial number": ("S12", {"connect": binds_nothing}),
    "finds anybody": ("S13", {"connect": finds_anybody}),
    "keeps control": ("S14", {"close": keeps_control}),
    "does not close": ("S14", {"close": nothing}),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_mistake_is_found_by_its_case(make_dut: MakeDut, mistake: str) -> None:
    number, members = MISTAKES[mistake]
    case = next(case for case in stereo.SUITE.cases if case.number == number)
    assert run_case(case, make_dut(**members)).outcome is CaseOutcome.FAIL


def test_every_stereo_case_has_its_mistake() -> None:
    """S15 to S18 are those of any device; the tracker's suite finds mistakes by them."""
    assert {number for number, _ in MISTAKES.values()} == {f"S{number:02d}" for number in range(1, 15)}
