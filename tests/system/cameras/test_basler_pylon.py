"""The adapter of the vendor's library on the cameras that the library itself emulates."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from coded_errors import raises
from spoilt_cameras import Stand

from conformance.case import CaseOutcome, SuiteCase
from conformance.report import run_case
from conformance.stereo import SUITE
from conformance.target import build_device_under_test
from drivers.basler_stereo.errors import (
    BAD_OPTIONS,
    NO_OUTPUT_LINE,
    NO_PYLON,
    OUT_OF_RANGE,
    WRONG_MODEL,
    NoCamera,
    TriggerMissed,
)
from drivers.basler_stereo.pylon.pair import PylonStereoPair
from drivers.basler_stereo.pylon.probe import probe
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle, StereoPair
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.readings import AreaOfInterest, Validity

os.environ.setdefault("PYLON_CAMEMU", "2")  # read once, when the library is loaded
AREA = AreaOfInterest(0, 0, 256, 128)  # the emulated sensors have 16 million pixels
SERIALS = ("0815-0000", "0815-0001")
EMULATION_LACKS = {
    "S05": "time stamps",
    "S11": "control privilege",
    "S12": "addresses",
    "S13": "addresses",
    "S19": "levels of lines",
}
pytestmark = pytest.mark.skipif(
    find_spec("pypylon") is None, reason="the optional extra pylon is not installed"
)


def configured(**options: object) -> DeviceConfig:
    return DeviceConfig(
        driver="basler_pylon",
        endpoints={"left": "gev://127.0.0.1", "right": "gev://127.0.0.2"},
        options={
            "device_class": "BaslerCamEmu",
            "left_serial": SERIALS[0],
            "right_serial": SERIALS[1],
            "expected_model": "Emulation",
            **options,
        },
    )


@pytest.fixture
def make_pair():
    made = []

    def make(**options) -> PylonStereoPair:
        made.append(PylonStereoPair("stereo", configured(**options), HostClock()))
        return made[-1]

    yield make
    for pair in made:
        pair.close()


def test_a_line_that_cannot_be_read_back_switches_no_projector(make_pair):
    for line, words in (("Out1", "no line Out1, only Line1"), ("Line2", "cannot be read back")):
        pair = make_pair(projector={"line": line})
        pair.connect()
        with raises(NO_OUTPUT_LINE, match=words):
            pair.configure()
        pair.close()


@pytest.fixture
def pair(make_pair):
    device = make_pair()
    device.connect()
    device.configure()
    device.set_areas(AREA, AREA)
    device.activate()
    return device


def node(pair, side, name):
    return pair._pair[side]._camera.GetNodeMap().GetNode(name)


def test_the_pair_is_a_stereo_pair_that_follows_the_lifecycle(make_pair):
    device = make_pair()
    assert isinstance(device, StereoPair)
    with pytest.raises(WrongState):
        device.grab_pair()
    assert device.connect().model == "Emulation"
    assert device.serials == SERIALS
    device.configure()
    device.activate()
    assert device.state is Lifecycle.ACTIVE
    device.deactivate()
    device.close()
    assert device.state is Lifecycle.CLOSED


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=case.number) for case in SUITE.cases if case.number not in EMULATION_LACKS],
)
def test_the_pair_passes_the_generic_suite_as_far_as_the_emulation_goes(case: SuiteCase) -> None:
    dut = build_device_under_test("stereo", configured(), HostClock())
    result = run_case(case, dut)
    dut.release()
    assert result.outcome is CaseOutcome.PASS, result.reason


def test_a_closed_pair_leaves_no_file_open(make_pair):
    def open_files() -> int:
        return len(os.listdir("/proc/self/fd"))

    def once() -> int:
        device = make_pair()
        device.connect()
        device.configure()
        device.activate()
        device.close()
        return open_files()

    before = once()  # what the library itself opens stays open
    assert once() == before


def test_every_trigger_gives_one_pair(pair):
    for number in (1, 2, 3):
        reading = pair.grab_pair()
        assert reading.validity is Validity.OK
        assert reading.stamp.sequence == number
        for image, serial, area in zip((reading.left, reading.right), SERIALS, pair.areas, strict=True):
            assert image.serial == serial
            assert image.pixels.shape == (area.height, area.width)
            assert not image.pixels.flags.writeable
            assert image.pixels.max() > 0


def test_areas_and_exposure_can_be_set_on_a_running_stream(pair):
    area = AreaOfInterest(64, 32, 128, 64)
    pair.set_areas(area, area)
    pair.set_exposure(3000.0, 200)
    assert pair.grab_pair().left.pixels.shape == (64, 128)
    assert [node(pair, side, "ExposureTimeAbs").GetValue() for side in (0, 1)] == [3000.0, 3000.0]
    with raises(OUT_OF_RANGE, match="GEV-011"):
        pair.set_areas(area, AreaOfInterest(0, 0, 1_000_000, 128))
    assert pair.areas == (area, area)
    assert pair.grab_pair().validity is Validity.OK


def test_twelve_bit_pixels_arrive_as_sixteen_bit_values(make_pair):
    device = make_pair(pixel_format="Mono12")
    device.connect()
    device.configure()
    device.set_areas(AREA, AREA)
    device.activate()
    assert device.grab_pair().left.pixels.dtype == np.uint16


def test_a_failed_buffer_leaves_its_partner_intact(pair):
    node(pair, 1, "ForceFailedBufferCount").SetValue(1)
    node(pair, 1, "ForceFailedBuffer").Execute()
    reading = pair.grab_pair()
    assert (reading.validity, reading.right) == (Validity.MISSING, None)
    assert reading.left.validity is Validity.OK
    assert pair.grab_pair().validity is Validity.OK


def test_a_trigger_that_reaches_no_camera_is_reported(pair, monkeypatch):
    for camera in pair._pair:
        monkeypatch.setattr(camera, "trigger", lambda: None)
    with pytest.raises(TriggerMissed, match="GEV-013"):
        pair.grab_pair(0.3)


def test_wrong_cameras_and_options_are_refused(make_pair):
    with pytest.raises(NoCamera, match="GEV-001"):
        make_pair(left_serial="0815-0009").connect()
    with raises(WRONG_MODEL, match="GEV-002"):
        make_pair(expected_model="acA2000-50gmNIR").connect()
    with raises(BAD_OPTIONS, match="GEV-016"):
        make_pair(trigger="line1")


class LonelyLibrary:
    """Stands for the library on a network without cameras; keeps what is asked for."""

    def __init__(self) -> None:
        self.asked: dict[str, str] = {}

    GenericException = RuntimeError

    def __getattr__(self, name: str):
        if name.startswith("Set"):
            return lambda value: self.asked.update({name.removeprefix("Set"): value})
        return self

    def __call__(self) -> LonelyLibrary:
        return self

    def CreateDevice(self, wanted: object) -> None:
        raise RuntimeError("No device is available\nat all")


def test_a_real_camera_is_looked_up_by_its_address_whatever_its_serial_number(make_pair, monkeypatch):
    library = LonelyLibrary()
    monkeypatch.setattr("drivers.basler_stereo.pylon.camera.load_pylon", lambda: (library, library))
    unseen = r"GEV-001: the installed pylon sees no camera at 127\.0\.0\.1: No device is available\."
    with pytest.raises(NoCamera, match=unseen):
        make_pair(device_class="BaslerGigE").connect()
    assert library.asked == {"DeviceClass": "BaslerGigE", "IpAddress": "127.0.0.1"}


def test_the_doctor_says_when_a_camera_replies_and_the_library_does_not_see_it(monkeypatch):
    library, stand = LonelyLibrary(), Stand()
    monkeypatch.setattr("drivers.basler_stereo.pylon.camera.load_pylon", lambda: (library, library))
    config = DeviceConfig(driver="basler_pylon", endpoints=stand.pair.endpoints)
    try:
        *_, left, right, device = probe("stereo", config, lambda share: None)
    finally:
        stand.close()
    assert (left.well, right.well, device.well) == (True, True, False)
    assert "GEV-001 the installed pylon sees no camera at" in device.seen
    assert device.advice.endswith(
        "If `ronna-procedure doctor` shows that it replies, use the driver basler_stereo."
    )


def test_the_doctor_shows_emulated_cameras_and_the_missing_library(monkeypatch):
    (device,) = probe("stereo", configured(), lambda share: None)
    assert device.well
    assert "Emulation 0815-0000+0815-0001" in device.seen
    monkeypatch.setitem(sys.modules, "pypylon", None)
    (device,) = probe("stereo", configured(), lambda share: None)
    assert "GEV-018" in device.seen
    assert "ronna-hw[pylon]" in device.advice


def test_without_the_library_the_error_names_how_to_install_it(make_pair, monkeypatch):
    monkeypatch.setitem(sys.modules, "pypylon", None)
    with raises(NO_PYLON, match=r"GEV-018.*ronna-hw\[pylon\]"):
        make_pair()
