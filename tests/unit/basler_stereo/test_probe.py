"""The cameras' probe tells who answers, who is in control, which packets arrive, and what that means."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from dataclasses import replace

import pytest
from spoilt_cameras import Stand
from waiting import eventually

from drivers.basler_stereo import camera_check
from drivers.basler_stereo import probe as camera_probe
from drivers.basler_stereo.camera_check import (
    CameraState,
    ControllingHost,
    ExpectedCamera,
    Response,
    camera_diagnostic,
    check_camera,
    discovery_diagnostic,
)
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.probe import probe
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import Diagnostic, Search
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.network import Interface
from ronna_hw.host.port_users import PortUser
from ronna_hw.wire.gige_vision import GVCP_PORT

MODEL = "acA2000-50gmNIR"
LEFT = CameraIdentity("192.168.3.11", "00:30:53:00:00:01", "Basler", MODEL, "21900001", "1.0", "left")
RIGHT = replace(LEFT, address="192.168.3.12", serial="21900002", user_name="right")
MANY = tuple(replace(RIGHT, address=f"192.168.3.{number}") for number in range(21, 27))
CARD = Interface("enp3s0", "192.168.3.1", 24, 9000)
ENDPOINT = Endpoint("gev", host="192.168.3.11")
EXPECTED = ExpectedCamera(ENDPOINT, LEFT.serial, MODEL)
WELL = CameraState(ENDPOINT, Response.ANSWERED, CARD, LEFT, ControllingHost(False), 8192)


# --- the diagnosis -----------------------------------------------------------------------------------------


def test_a_healthy_camera_reports_its_network_card_and_packet_size() -> None:
    diagnostic = camera_diagnostic(WELL, (), EXPECTED)
    assert diagnostic.well
    assert diagnostic.advice == ""
    assert "enp3s0 (192.168.3.1, MTU 9000)" in diagnostic.seen
    assert "no application in control" in diagnostic.seen
    assert "packets of 8192 bytes arrive" in diagnostic.seen


@pytest.mark.parametrize(
    ("camera", "found", "seen", "advice"),
    [
        (CameraState(ENDPOINT, Response.SILENT, CARD), (), "silent via enp3s0", "power and cable"),
        (CameraState(ENDPOINT, Response.SILENT, CARD), (RIGHT,), "silent", "21900002 at 192.168.3.12"),
        (
            CameraState(ENDPOINT, Response.SILENT, replace(CARD, address="10.0.0.5")),
            (),
            "silent",
            "No network card of this computer is in its subnet",
        ),
        (CameraState(ENDPOINT, Response.REFUSED, CARD), (), "refused", "not a camera"),
        (
            CameraState(ENDPOINT, Response.NO_ROUTE, reason="Network is unreachable"),
            (),
            "no route: Network is unreachable",
            "an address in the camera's subnet",
        ),
        (
            replace(WELL, identity=replace(LEFT, model="acA640-120gm")),
            (),
            "acA640-120gm",
            "Expected a acA2000",
        ),
        (
            replace(WELL, identity=RIGHT),
            (replace(LEFT, address="192.168.3.12"), replace(LEFT, address="192.168.3.13")),
            "camera 21900002, expected 21900001",
            "is at 192.168.3.12 (and replied 2 times): swap cables",
        ),
        (replace(WELL, identity=RIGHT), (), "camera 21900002, expected 21900001", "recalibrate the head"),
        (CameraState(ENDPOINT, Response.SILENT, CARD), MANY, "silent", "Check power and cable of the camera"),
        (CameraState(ENDPOINT, Response.SILENT, CARD), MANY, "silent", "at 192.168.3.24 and 2 more."),
        (
            replace(WELL, controller=ControllingHost(True, "192.168.3.7", 40001), packet_bytes=None),
            (),
            "controlled by 192.168.3.7:40001",
            "on the other computer",
        ),
        (
            replace(
                WELL, controller=ControllingHost(True, "192.168.3.1", 40001, PortUser(812, "pylon viewer"))
            ),
            (),
            "controlled by pylon viewer (pid 812)",
            "If it runs a case, leave it alone",
        ),
        (
            replace(WELL, controller=ControllingHost(True, "192.168.3.1", 40001, here=True)),
            (),
            "controlled by 192.168.3.1:40001",
            "has ended, or belongs to another user",
        ),
        (
            replace(WELL, controller=ControllingHost(True)),
            (),
            "application not identified by the camera",
            "heartbeat",
        ),
        (replace(WELL, packet_bytes=None), (), "no application in control", "power-cycle it"),
        (replace(WELL, packet_bytes=0), (), "no application in control", "firewall"),
    ],
    ids=[
        "silent",
        "silent, another answers",
        "another subnet",
        "refused",
        "no way",
        "another model",
        "swapped",
        "another serial",
        "silent, many answer",
        "silent, more answer than are listed",
        "controlled from elsewhere",
        "controlled from here",
        "controlled from here, unseen",
        "controlled by somebody",
        "no control",
        "no test packets",
    ],
)
def test_an_unhealthy_camera_gets_a_cause_in_plain_words(
    camera: CameraState, found: tuple[CameraIdentity, ...], seen: str, advice: str
) -> None:
    diagnostic = camera_diagnostic(camera, found, EXPECTED)
    assert not diagnostic.well
    assert seen in diagnostic.seen
    assert advice in diagnostic.advice
    assert diagnostic.document is not None
    assert diagnostic.document["cause"] == diagnostic.advice


def test_a_serial_number_that_replied_several_times_is_reported() -> None:
    assert discovery_diagnostic(CARD, (LEFT, RIGHT)).advice == ""
    assert "21900002 replied several times" in discovery_diagnostic(CARD, (LEFT, *MANY)).advice


def test_small_packets_are_accepted_with_advice_for_larger_ones() -> None:
    diagnostic = camera_diagnostic(
        replace(WELL, packet_bytes=1500, interface=replace(CARD, mtu_bytes=1500)), (), EXPECTED
    )
    assert diagnostic.well
    assert "packets of 1500 bytes arrive" in diagnostic.seen
    assert "enp3s0 has an MTU of 1500" in diagnostic.advice


# --- the state ---------------------------------------------------------------------------------------------

SERIALS = ("21904411", "21904412")
NOBODY = "127.76.9.9"


@pytest.fixture
def stand() -> Iterator[Stand]:
    made = Stand()
    yield made
    made.close()


def probed(stand: Stand) -> CameraState:
    return check_camera(parse_endpoint(stand.pair.endpoints["left"]))


def test_a_camera_is_queried_measured_and_released(stand: Stand) -> None:
    stand.world.set_fault_script("now: camera narrow path left 1500 bytes")
    for _ in range(2):  # the first look leaves nothing behind
        found = probed(stand)
        assert found.response is Response.ANSWERED
        assert found.identity is not None
        assert (found.identity.serial, found.identity.model) == (SERIALS[0], MODEL)
        assert found.interface is not None
        assert found.interface.loopback
        assert found.controller == ControllingHost(False)
        assert found.packet_bytes == 1500


def test_a_camera_under_control_of_another_client_is_left_alone(stand: Stand) -> None:
    stand.world.set_fault_script("now: camera seize left")
    eventually(lambda: (seen := probed(stand).controller) is not None and seen.taken)
    found = probed(stand)
    assert found.packet_bytes is None


def test_a_camera_without_test_packets_is_reported(stand: Stand) -> None:
    stand.world.set_fault_script("now: camera narrow path left 100 bytes")
    assert probed(stand).packet_bytes == 0


def test_a_closed_port_and_a_silent_one_are_distinguished(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_check, "REPLY_LIMIT_S", 0.2)
    endpoint = Endpoint("gev", host=NOBODY)
    assert check_camera(endpoint).response is Response.REFUSED
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind((NOBODY, GVCP_PORT))
        assert check_camera(endpoint).response is Response.SILENT


def test_a_network_that_goes_down_during_the_look_is_reported(
    stand: Stand, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object) -> socket.socket:
        raise OSError(errno.EADDRNOTAVAIL, "Cannot assign requested address")

    monkeypatch.setattr(camera_check, "open_stream_socket", gone)
    found = probed(stand)
    assert (found.response, found.reason) == (Response.NO_ROUTE, "Cannot assign requested address")


# --- the diagnostics --------------------------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Interface]:
    """Collect the interfaces asked by broadcast discovery, which finds the right camera; nothing is sent."""
    networks: list[Interface] = []

    def discover(interface: Interface) -> tuple[CameraIdentity, ...]:
        networks.append(interface)
        return (RIGHT,)

    monkeypatch.setattr(camera_probe, "discover_cameras", discover)
    monkeypatch.setattr(camera_probe, "check_camera", lambda each: CameraState(each, Response.SILENT))
    return networks


def looked_at(*addresses: str) -> list[Diagnostic]:
    return list(probe.probe_endpoints([Endpoint("gev", host=each) for each in addresses], lambda share: None))


def test_broadcast_discovery_stays_on_the_network_of_the_given_addresses(asked: list[Interface]) -> None:
    first, *_ = looked_at(NOBODY, "127.76.9.10")
    assert [network.loopback for network in asked] == [True]
    assert first.subject == "cameras on lo"
    assert "21900002 at 192.168.3.12" in first.seen


def test_cameras_of_two_owners_on_one_network_are_never_paired(monkeypatch: pytest.MonkeyPatch) -> None:
    owned = [replace(each, info=owner) for owner in ("theatre 1", "theatre 2") for each in (LEFT, RIGHT)]
    monkeypatch.setattr(
        camera_probe,
        "discover_cameras",
        lambda network: tuple(
            replace(each, address=f"192.168.3.{number}") for number, each in enumerate(owned, 11)
        ),
    )
    first, second = probe.find(Search(interfaces=(CARD,)), lambda share: None)
    assert list(first.endpoints.values()) == ["gev://192.168.3.11", "gev://192.168.3.12"]
    assert list(second.endpoints.values()) == ["gev://192.168.3.13", "gev://192.168.3.14"]
    assert "theatre 2" in second.what


def test_nothing_is_broadcast_for_an_address_outside_the_subnets_of_this_computer(
    asked: list[Interface],
) -> None:
    (diagnostic,) = looked_at("203.0.113.1")
    assert asked == []
    assert diagnostic.subject == "camera gev://203.0.113.1"


def test_the_cameras_of_a_theatre_file_are_reported_with_their_cause(stand: Stand) -> None:
    config = DeviceConfig(
        driver="basler_stereo",
        endpoints={"left": stand.pair.endpoints["left"], "right": f"gev://{NOBODY}"},
        options={"left_serial": SERIALS[0], "right_serial": SERIALS[1]},
    )
    *_, first, second, device = probe("stereo", config, lambda share: None)
    assert first.document is not None
    assert second.document is not None
    assert (first.well, first.section, first.document["packet_bytes"]) == (True, "cameras", 8192)
    assert first.document["camera"]["serial"] == SERIALS[0]
    assert (second.well, second.document["access"], second.document["camera"]) == (False, "refused", None)
    assert device.subject == "device stereo"
    assert "GEV-001" in device.seen
    assert device.advice == second.advice
