"""The arm's probe identifies a controller, and says of any other address why there is none."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from handmade_ur import HandmadeController

from drivers.universal_robots import probe as ur_probe
from drivers.universal_robots.probe import probe
from ronna_hw.devices.probing import Finder, Proposal, Search
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.network import Interface

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
    controller.answers["get robot model"] = "UR10"
    (proposal,) = found(Search(controllers=(HERE,)))
    assert "URD-003" in proposal.remarks[0]
    assert "serial" not in chosen(proposal)


def test_an_address_without_a_controller_says_so_and_on_a_network_it_is_passed_over(
    controller: HandmadeController,
) -> None:
    controller.banner = b"SSH-2.0-OpenSSH\r\n"
    (proposal,) = found(Search(controllers=(HERE,)))
    assert "no dashboard server" in proposal.absent
    assert found(Search(interfaces=(LOOPBACK,))) == []


def test_the_example_is_complete_and_names_what_was_searched() -> None:
    assert isinstance(probe, Finder)
    example = probe.example(Search(interfaces=(LOOPBACK,)))
    assert set(example.endpoints) == {"rtde", "dashboard", "primary"}
    assert example.absent == "no dashboard at port 29999 of 127.0.0.1"
