"""The arm's probe tells whether the driver can bind the stream port, and what the controller reports."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from xml.etree import ElementTree

import pytest
from fake_controller import FakeController

from drivers.kuka_rsi import probe as kuka_probe
from drivers.kuka_rsi.arm import KukaRsiArm
from drivers.kuka_rsi.eki.telegrams import read_state
from drivers.kuka_rsi.probe import probe, stream_port_diagnostic
from drivers.kuka_rsi.readiness import controller_facts
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import TellsReadiness
from ronna_hw.devices.lifecycle import Device, Identity
from ronna_hw.devices.probing import Diagnostic, Search
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.network import Interface, own_udp_endpoint


@pytest.fixture
def taken() -> Iterator[Endpoint]:
    """Occupy a port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        yield Endpoint("udp", "127.0.0.1", other.getsockname()[1])


def test_a_free_port_passes_and_stays_free(taken: Endpoint) -> None:
    free = Endpoint("udp", "127.77.0.1", taken.port)
    assert stream_port_diagnostic(free).well
    assert stream_port_diagnostic(free).well


def test_a_port_in_use_names_the_program(taken: Endpoint) -> None:
    diagnostic = stream_port_diagnostic(taken)
    assert not diagnostic.well
    assert f"(pid {os.getpid()})" in diagnostic.seen
    assert "If it runs a case, leave it alone" in diagnostic.advice


def test_a_port_in_use_by_an_invisible_program_names_the_command_that_finds_it(
    taken: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kuka_probe, "find_udp_port_user", lambda _address, _port: None)
    diagnostic = stream_port_diagnostic(taken)
    assert "not visible to this user" in diagnostic.seen
    assert f"ss -ulnp 'sport = {taken.port}'" in diagnostic.advice


def test_an_address_of_another_subnet_is_reported_as_not_local() -> None:
    diagnostic = stream_port_diagnostic(Endpoint("udp", "192.0.2.1", 59152))  # for documents: RFC 5737
    assert not diagnostic.well
    assert "192.0.2.1 is not an address of this computer" in diagnostic.seen
    assert "Ethernet file" in diagnostic.advice


def test_the_probe_reports_the_stream_port_and_why_the_arm_is_unreachable(taken: Endpoint) -> None:
    endpoints = {"rsi": str(taken), "eki_project": "tcp://127.0.0.1:1"}
    stream, arm = kuka_probe.probe(
        "robot.master", DeviceConfig(driver="kuka_rsi", endpoints=endpoints), lambda share: None
    )
    assert (stream.subject, arm.subject) == (f"stream port {taken}", "device robot.master")
    assert "EKI-001" in arm.seen
    assert "Nothing listens at tcp://127.0.0.1:1" in arm.advice


def test_a_pressed_emergency_stop_is_named_with_its_remedy(controller: FakeController) -> None:
    endpoints = {"rsi": own_udp_endpoint(), "eki_project": f"tcp://127.0.0.1:{controller.eki_port}"}
    controller.facts["EStop"] = "1"
    facts = {}

    def inspect(arm: Device, _identity: Identity) -> tuple[Diagnostic, ...]:
        assert isinstance(arm, TellsReadiness)
        facts.update({fact.name: fact for fact in arm.readiness()})
        return ()

    config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints)
    _, arm = kuka_probe.probe("robot.master", config, lambda share: None, inspect)
    assert arm.well
    assert [name for name, fact in facts.items() if not fact.ready] == ["emergency stop"]
    assert facts["emergency stop"].advice.startswith("Release the emergency stop")
    assert facts["drives"].found == "on"
    assert facts["brakes"].found == "open"
    assert facts["operating mode"].found == "EXT"


@pytest.mark.parametrize(
    ("drives", "moving", "brakes", "found", "well"),
    [
        ("1", "0", "63", "open", True),
        ("0", "0", "0", "closed: A1 A2 A3 A4 A5 A6", True),
        ("1", "0", "0", "closed: A1 A2 A3 A4 A5 A6", True),  # after a long standstill
        ("1", "1", "62", "closed while the arm moves: A1", False),
        ("0", "0", "4", "open while the drives are off: A3", False),
        ("1", "0", "", "not reported; normally released while the drives are on", True),
        ("0", "0", None, "not reported; the drives are off", True),
    ],
)
def test_brakes_are_judged_as_the_controller_reports_them(
    controller: FakeController, drives: str, moving: str, brakes: str | None, found: str, well: bool
) -> None:
    controller.facts |= {"Drives": drives, "Moving": moving}
    if brakes is None:  # files of an earlier version
        del controller.facts["Brakes"]
    else:
        controller.facts["Brakes"] = brakes
    state = read_state(ElementTree.fromstring(controller.state()), 0.0)
    (fact,) = (one for one in controller_facts(state) if one.name == "brakes")
    assert (fact.found, fact.ready, bool(fact.advice)) == (found, well, not well)


@pytest.mark.parametrize(("said", "serial"), [("601234", "601234"), ("0", ""), (None, "")])
def test_the_arm_has_the_serial_number_that_its_controller_reports(
    controller: FakeController, make_arm: Callable[[], KukaRsiArm], said: str | None, serial: str
) -> None:
    if said is None:  # files of an earlier version
        del controller.facts["Serial"]
    else:
        controller.facts["Serial"] = said
    identity = make_arm().connect()
    assert identity.serial == serial
    assert ("verified", "yes") in identity.details


def test_a_controller_that_hangs_up_at_once_is_reported_as_serving_another_client() -> None:
    with socket.create_server(("127.0.0.1", 0)) as busy:
        endpoints = {"rsi": own_udp_endpoint(), "eki_project": f"tcp://127.0.0.1:{busy.getsockname()[1]}"}

        def refuse() -> None:
            busy.accept()[0].close()

        refusing = threading.Thread(target=refuse)
        refusing.start()
        _, arm = kuka_probe.probe(
            "robot.master", DeviceConfig(driver="kuka_rsi", endpoints=endpoints), lambda share: None
        )
        refusing.join()
    assert "EKI-002" in arm.seen
    assert "another run or another computer has the arm" in arm.advice
    assert "Or this port is not the controller's: our EKI server listens on 54602" in arm.advice
    assert "Recover" not in arm.advice


def test_the_example_for_a_controller_that_was_not_found_says_what_was_searched() -> None:
    office = Interface("eth7", "192.0.2.9", 24, mtu_bytes=1500)
    found = probe.example(Search(interfaces=(office,))).absent
    assert found == "no EKI server of ours at port 54602 of 253 addresses, 192.0.2.1 to 192.0.2.254"
    loopback = Interface("lo", "127.0.0.1", 8, mtu_bytes=0)
    assert probe.example(Search(interfaces=(loopback,))).absent.endswith("54602 of 127.0.0.1")
    assert probe.example(Search()).absent == ""
