"""The suite tests the device named on the command line; mistakes are reported before anything starts."""

from __future__ import annotations

import itertools
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import pytest
from coded_errors import raises

from conformance.device_under_test import DeviceUnderTest
from conformance.errors import DEVICE_NOT_IN_FILE, NO_DEVICE_CHOSEN, NO_SIMULATOR
from conformance.protocol import ProtocolCases
from conformance.target import DeviceChoice, device_under_test, resolve_target
from ronna_hw.devices.errors import UNKNOWN_DRIVER
from ronna_hw.host.child_process import ChildNotReady

THEATRE = """
schema = 1
theatre = "two arms"
[tracker]
driver = "ndi_polaris"
endpoint = "tcp://127.0.0.1:8765"
options = { tools = [{ name = "M", rom = "robot_frame.rom" }] }
[robot.left]
driver = "kuka_rsi"
endpoints = { rsi = "udp://127.0.0.1:1", eki_project = "tcp://127.0.0.1:2" }
[robot.right]
driver = "kuka_rsi"
endpoints = { rsi = "udp://127.0.0.1:3", eki_project = "tcp://127.0.0.1:4" }
"""


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    path = tmp_path / "theatre.toml"
    path.write_text(THEATRE)
    return path


def under_test(kind: str, choice: DeviceChoice) -> AbstractContextManager[DeviceUnderTest]:
    return device_under_test(resolve_target(kind, choice))


def test_a_device_from_a_theatre_file_keeps_its_options(theatre: Path) -> None:
    with under_test("tracker", DeviceChoice(config=theatre)) as dut:
        assert dut.name == "tracker"
        assert dut.config.endpoint == "tcp://127.0.0.1:8765"
        assert dut.make().tools == ("M",)
        assert "destructive" not in dut.offers
        assert {
            "line faults",
            "checked replies",
            "polaris bytes",
            "tool definition",
            "host time",
        } <= dut.offers


def test_a_device_missing_from_the_file_is_reported(theatre: Path) -> None:
    with (
        raises(DEVICE_NOT_IN_FILE) as caught,
        under_test("stereo", DeviceChoice(config=theatre)),
    ):
        pass
    assert caught.value.code == "CNF-002"
    no_robot = theatre.with_name("no_robot.toml")
    no_robot.write_text('schema = 1\ntheatre = "empty"\n[clock]\nendpoint = "host:"\n')
    with raises(DEVICE_NOT_IN_FILE, match=r"has no robot;? .*\[robot.master\]"):
        resolve_target("robot", DeviceChoice(config=no_robot))
    with raises(DEVICE_NOT_IN_FILE, match="no tracker left"):
        resolve_target("tracker", DeviceChoice(config=theatre, device="left"))
    for device in (None, "middle"):
        with (
            raises(DEVICE_NOT_IN_FILE, match="left, right"),
            under_test("robot", DeviceChoice(config=theatre, device=device)),
        ):
            pass


def test_an_endpoint_alone_selects_the_default_driver_and_options() -> None:
    with under_test(
        "tracker", DeviceChoice(endpoints=("serial:///dev/ttyUSB0",), allow=("destructive",))
    ) as dut:
        assert dut.config.driver == "ndi_polaris"
        assert dut.make().tools == ("robot_frame",)
        assert "destructive" in dut.offers


def test_named_endpoints_reach_the_driver_under_their_names() -> None:
    named = ("rsi=udp://127.0.0.1:1", "eki_project=tcp://127.0.0.1:2")
    with under_test("robot", DeviceChoice(endpoints=named)) as dut:
        assert dut.config.endpoints == {"rsi": "udp://127.0.0.1:1", "eki_project": "tcp://127.0.0.1:2"}


def test_endpoints_with_other_names_are_refused_with_all_names_and_an_example() -> None:
    given = ("rtde=tcp://127.0.0.1:1", "dashbord=tcp://127.0.0.1:2")
    with raises(NO_DEVICE_CHOSEN) as caught:
        resolve_target("robot", DeviceChoice(endpoints=given, driver="universal_robots"))
    assert "did you mean 'dashboard'" in caught.value.what
    assert caught.value.expected == "rtde, dashboard, primary"


@pytest.mark.parametrize(
    "given",
    [
        ("tcp://127.0.0.9:30004",),
        ("rtde=tcp://127.0.0.9:1", "dashboard=tcp://127.0.0.9:2", "primary=tcp://127.0.0.9:3"),
    ],
)
def test_endpoints_of_another_make_name_its_driver_with_all_its_endpoints(given: tuple[str, ...]) -> None:
    with raises(NO_DEVICE_CHOSEN) as caught:
        resolve_target("robot", DeviceChoice(endpoints=given))
    assert caught.value.advice == (
        "They look like those of universal_robots: --driver universal_robots "
        "--endpoint rtde=tcp://127.0.0.9:30004 --endpoint dashboard=tcp://127.0.0.9:29999 "
        "--endpoint primary=tcp://127.0.0.9:30001."
    )


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ur5e", "ur5e is a model of universal_robots: --driver universal_robots."),
        ("ur5", 'a model of universal_robots: --driver universal_robots, and --config .* model = "ur5"'),
        ("kr6_r900_sixx", "kr6_r900_sixx is a variant of kuka_rsi: --driver kuka_rsi"),
        ("tea", "Correct --driver"),
    ],
)
def test_a_model_given_as_a_driver_names_its_driver(name: str, said: str) -> None:
    with raises(UNKNOWN_DRIVER, match=f"DEV-002: no driver '{name}' is installed; .*{said}"):
        resolve_target("robot", DeviceChoice(endpoints=("tcp://127.0.0.9:30004",), driver=name))


def test_an_equals_sign_in_an_address_does_not_make_a_name() -> None:
    with under_test("tracker", DeviceChoice(endpoints=("serial:///dev/a=b",))) as dut:
        assert dut.config.endpoint == "serial:///dev/a=b"


def test_a_simulator_that_does_not_start_is_reported() -> None:
    target = resolve_target("tracker", DeviceChoice(sim=True))
    broken = replace(target.protocol, simulator=lambda: ("no-such-device",))
    with pytest.raises(ChildNotReady), device_under_test(replace(target, protocol=broken)):
        pass


def test_a_driver_whose_protocol_has_no_simulator_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("conformance.target.load_driver_protocol", lambda driver: ProtocolCases())
    with raises(NO_SIMULATOR) as caught:
        resolve_target("tracker", DeviceChoice(sim=True))
    assert caught.value.code == "CNF-006"


def test_the_suite_ends_with_the_cases_of_the_drivers_wire_protocol() -> None:
    letters = [case.number[0] for case in resolve_target("robot", DeviceChoice(sim=True)).suite.cases]
    assert "".join(letter for letter, _ in itertools.groupby(letters)) == "RKL"
