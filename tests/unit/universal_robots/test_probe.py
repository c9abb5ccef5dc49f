"""The arm's probe identifies a controller, and says of any other address why there is none."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator

import pytest
from handmade_ur import HandmadeController

from drivers.universal_robots import probe as ur_probe
from drivers.universal_robots import services
from drivers.universal_robots.arm import UniversalRobotsArm
from drivers.universal_robots.probe import probe
from drivers.universal_robots.services import SERVICES
from procedures.cli.new_theatre.searching import DeviceTable
from procedures.cli.new_theatre.writing import theatre_text
from ronna_hw.clock import HostClock
from ronna_hw.config import BadTheatreFile, DeviceConfig, parse_theatre
from ronna_hw.devices.probing import Finder, Proposal, Search
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.network import Interface
from ronna_hw.wire.universal_robots import (
    DASHBOARD_PORT,
    PRIMARY_PORT,
    READ_ONLY_PRIMARY_PORT,
    RTDE_PORT,
    SECONDARY_PORT,
)

HERE = Endpoint("tcp", "127.0.0.1", 54602)  # its port is another arm's
LOOPBACK = Interface("lo", "127.0.0.1", 8, True)


@pytest.fixture
def controller(monkeypatch: pytest.MonkeyPatch) -> Iterator[HandmadeController]:
    """A controller whose ports are taken for the standard ones."""
    made = HandmadeController()
    ports = {role: parse_endpoint(text).port for role, text in made.endpoints.items()}
    monkeypatch.setattr(ur_probe, "PORTS", ports)
    yield made
    made.close()


def found(search: Search) -> list[Proposal]:
    return list(probe.find(search, lambda share: None))


def chosen(proposal: Proposal) -> dict[str, object]:
    return {option.key: option.value for option in proposal.options if option.chosen}


@pytest.mark.parametrize("search", [Search(controllers=(HERE,)), Search(interfaces=(LOOPBACK,))])
def test_a_controller_is_proposed_with_its_arm_and_calibration(
    controller: HandmadeController, search: Search
) -> None:
    (proposal,) = found(search)
    assert not proposal.absent
    assert proposal.endpoints == controller.endpoints
    options = chosen(proposal)
    assert (options["model"], options["serial"]) == ("ur5e", "20265500001")
    assert options["calibration"]


def test_an_arm_that_the_driver_does_not_know_is_proposed_with_the_reason(
    controller: HandmadeController,
) -> None:
    controller.answers["get robot model"] = "UR20"
    (proposal,) = found(Search(controllers=(HERE,)))
    assert "URD-003" in proposal.remarks[0]
    assert "serial" not in chosen(proposal)


def test_a_size_of_the_e_series_is_proposed_by_what_the_controller_reports(
    controller: HandmadeController,
) -> None:
    controller.answers["get robot model"] = "UR10"
    (proposal,) = found(Search(controllers=(HERE,)))
    assert chosen(proposal)["model"] == "ur10e"


def test_an_address_without_a_controller_says_so_and_on_a_network_it_is_passed_over(
    controller: HandmadeController,
) -> None:
    controller.banner = b"SSH-2.0-OpenSSH\r\n"
    (proposal,) = found(Search(controllers=(HERE,)))
    assert "no dashboard server" in proposal.absent
    assert found(Search(interfaces=(LOOPBACK,))) == []


def test_the_fingerprint_of_the_factory_calibration_is_reported(controller: HandmadeController) -> None:
    (proposal,) = found(Search(controllers=(HERE,)))
    config = DeviceConfig(driver="universal_robots", endpoints=controller.endpoints)
    seen = {one.subject: one.seen for one in probe("robot.master", config, lambda share: None)}
    assert seen["robot.master: factory calibration"] == chosen(proposal)["calibration"]


@pytest.mark.parametrize("port", [SECONDARY_PORT, RTDE_PORT, READ_ONLY_PRIMARY_PORT])
def test_an_endpoint_at_the_port_of_another_service_is_refused_with_the_port_of_its_own(port: int) -> None:
    endpoints = dict(probe.example(Search()).endpoints) | {"primary": f"tcp://127.0.0.1:{port}"}
    config = DeviceConfig(driver="universal_robots", endpoints=endpoints)
    with pytest.raises(BadTheatreFile, match=rf"assistant.endpoints\] primary: port {port} .* port 30001"):
        UniversalRobotsArm("robot.assistant", config, HostClock())


@pytest.mark.parametrize(
    ("role", "port", "says"),
    [
        ("dashboard", DASHBOARD_PORT, "arm UR5, RUNNING"),
        ("rtde", RTDE_PORT, "software 5.11.5.1010327"),
        ("primary", PRIMARY_PORT, "it sends the arm's state"),
        ("primary", SECONDARY_PORT, "it sends the arm's state"),
    ],
)
def test_each_service_of_a_controller_is_recognized_at_its_port(
    controller: HandmadeController, monkeypatch: pytest.MonkeyPatch, role: str, port: int, says: str
) -> None:
    endpoint = parse_endpoint(controller.endpoints[role])
    monkeypatch.setitem(SERVICES, endpoint.port, SERVICES[port])
    (diagnostic,) = probe.probe_endpoints([endpoint], lambda share: None)
    assert diagnostic.well
    assert diagnostic.seen.endswith(f"of a Universal Robots controller: {says}")
    assert diagnostic.command == "ronna-procedure new-theatre --controller 127.0.0.1"


@pytest.mark.parametrize("port", SERVICES)
def test_another_server_at_a_port_of_a_controller_is_none(
    controller: HandmadeController, monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    controller.banner = b"SSH-2.0-OpenSSH\r\n"
    monkeypatch.setattr(services, "CONNECT_LIMIT_S", 0.2)
    endpoint = parse_endpoint(controller.endpoints["dashboard"])
    monkeypatch.setitem(SERVICES, endpoint.port, SERVICES[port])
    (diagnostic,) = probe.probe_endpoints([endpoint], lambda share: None)
    assert not diagnostic.well
    assert diagnostic.advice


def test_a_found_controller_is_written_to_a_theatre_file_that_can_be_read(
    controller: HandmadeController,
) -> None:
    (proposal,) = found(Search(controllers=(HERE,)))
    text = theatre_text("lab", [DeviceTable("robot", proposal, is_found=True)], "host:", {})
    robot = parse_theatre(tomllib.loads(text)).robot["master"]
    assert robot.endpoints == controller.endpoints
    assert robot.options["model"] == "ur5e"
    assert "# tool_inputs = [0, 1, 2, 3]\n" in text


def test_the_example_is_complete_and_names_what_was_searched() -> None:
    assert isinstance(probe, Finder)
    example = probe.example(Search(interfaces=(LOOPBACK,)))
    assert set(example.endpoints) == {"rtde", "dashboard", "primary"}
    assert example.absent == "no dashboard at port 29999 of 127.0.0.1"
