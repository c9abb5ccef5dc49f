"""The driver switches the line projector on an output line, reads it back, and leaves it off."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from coded_errors import raises
from spoilt_cameras import Stand

from conformance.case import CaseOutcome
from conformance.report import run_case
from conformance.stereo import SUITE
from conformance.target import build_device_under_test
from drivers.basler_stereo.errors import BAD_OPTIONS, NO_OUTPUT_LINE, NO_PROJECTOR, OUTPUT_STUCK
from drivers.basler_stereo.pair import BaslerStereoPair
from drivers.basler_stereo.probe import probe
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.sensors import line_projector

MakePair = Callable[..., BaslerStereoPair]


@pytest.fixture
def stand() -> Iterator[Stand]:
    made = Stand()
    yield made
    made.close()


def configured(stand: Stand, projector: dict[str, object] | None) -> DeviceConfig:
    options = {} if projector is None else {"projector": projector}
    return DeviceConfig(driver="basler_stereo", endpoints=stand.pair.endpoints, options=options)


@pytest.fixture
def make_pair(stand: Stand) -> Iterator[MakePair]:
    made: list[BaslerStereoPair] = []

    def make(**projector: object) -> BaslerStereoPair:
        made.append(BaslerStereoPair("stereo", configured(stand, projector or None), HostClock()))
        made[-1].connect()
        return made[-1]

    yield make
    for pair in made:
        pair.close()


@pytest.mark.hazard(69)
@pytest.mark.parametrize("source", ["UserOutput", "ExposureActive"])
def test_the_projector_lights_exposures_until_the_streams_stop(
    stand: Stand, make_pair: MakePair, source: str
) -> None:
    pair = make_pair(source=source)
    pair.configure()
    pair.activate()
    assert line_projector(pair) is pair
    found = []
    for on in (True, False, True):
        pair.set_projector(on)
        found.append((pair.projector_on, stand.left.lights_exposure))
    assert found == [(True, True), (False, False), (True, True)]
    pair.deactivate()
    assert (pair.projector_on, stand.left.lights_exposure) == (False, False)


@pytest.mark.hazard(69)
def test_closing_switches_the_projector_off(stand: Stand, make_pair: MakePair) -> None:
    pair = make_pair(line="Out1")
    pair.configure()
    pair.set_projector(True)
    assert stand.left.lights_exposure
    pair.close()
    assert not stand.left.lights_exposure


def test_an_inverted_projector_is_lit_while_its_line_is_low(stand: Stand, make_pair: MakePair) -> None:
    pair = make_pair(inverted=True)
    pair.configure()
    assert stand.left.lights_exposure  # a high line, which leaves such a projector dark
    pair.set_projector(True)
    assert not stand.left.lights_exposure


@pytest.mark.hazard(69)
def test_a_line_that_does_not_follow_is_an_error(
    stand: Stand, make_pair: MakePair, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = make_pair(line="Out1")
    pair.configure()
    monkeypatch.setattr(type(stand.left), "output_held_low", True)
    with raises(OUTPUT_STUCK, match="Out1 of the left camera is low with the projector on"):
        pair.set_projector(True)


@pytest.mark.parametrize(
    ("projector", "words"),
    [
        ({"line": "Out2"}, "the left camera has no line Out2, only Line1, Out1"),
        ({"camera": "right", "line": "Line1"}, "Line1 of the right camera is an input"),
    ],
)
def test_a_line_that_is_no_output_is_named(
    make_pair: MakePair, projector: dict[str, str], words: str
) -> None:
    with raises(NO_OUTPUT_LINE, match=words):
        make_pair(**projector).configure()


def test_a_head_without_a_projector_says_so(make_pair: MakePair) -> None:
    pair = make_pair()
    with pytest.raises(WrongState):
        pair.set_projector(True)
    pair.configure()
    assert line_projector(pair) is None
    with raises(NO_PROJECTOR):
        pair.set_projector(True)


def test_an_unknown_source_is_a_mistake_in_the_theatre_file(make_pair: MakePair) -> None:
    with raises(BAD_OPTIONS, match="projector.source"):
        make_pair(source="Timer1Active")


def test_the_doctor_names_a_line_that_does_not_exist(stand: Stand) -> None:
    found = {
        line: next(
            one
            for one in probe("stereo", configured(stand, {"line": line}), lambda _: None)
            if one.subject == "line projector"
        )
        for line in ("Out1", "Out2")
    }
    assert found["Out1"].well
    assert not found["Out2"].well
    assert found["Out2"].seen == "the left camera has no line Out2, only Line1, Out1"


def test_the_conformance_case_of_a_projector_passes(stand: Stand) -> None:
    dut = build_device_under_test("stereo", configured(stand, {"line": "Out1"}), HostClock())
    try:
        case = next(one for one in SUITE.cases if one.number == "S19")
        assert run_case(case, dut).outcome is CaseOutcome.SKIP  # lights nothing without permission
        dut.offers |= {"output"}
        assert run_case(case, dut).outcome is CaseOutcome.PASS
    finally:
        dut.release()
