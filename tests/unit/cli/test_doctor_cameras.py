"""The doctor's camera part: what answers, who controls it, which packets pass, and what that means."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from peer_cameras import SERIALS, Peer, free_address

from procedures.cli.camera_cause import document, judge
from procedures.cli.camera_probe import About, Access, CameraProbe, Control, found_around, probe_camera
from procedures.cli.doctor import examine, show
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.network_interfaces import Interface
from ronna_hw.host.port_users import PortUser
from ronna_hw.wire.gige_vision import GVCP_PORT

MODEL = "acA2000-50gmNIR"
LEFT = About("192.168.3.11", "Basler", MODEL, "21900001", "left", "1.0")
RIGHT = replace(LEFT, address="192.168.3.12", serial="21900002", name="right")
CARD = Interface("enp3s0", "192.168.3.1", 24, 9000)
ENDPOINT = Endpoint("gev", host="192.168.3.11")
WELL = CameraProbe(ENDPOINT, Access.ANSWERED, CARD, LEFT, Control(False), 8192)


# --- the verdict -------------------------------------------------------------------------------------------


def test_a_camera_that_is_well_says_by_which_card_and_with_which_packets() -> None:
    verdict = judge(WELL, (), LEFT.serial, MODEL)
    assert verdict.well
    assert verdict.advice == ""
    assert "enp3s0 (192.168.3.1, MTU 9000)" in verdict.seen
    assert "nobody in control" in verdict.seen
    assert "packets of 8192 bytes pass" in verdict.seen


@pytest.mark.parametrize(
    ("probe", "found", "seen", "advice"),
    [
        (CameraProbe(ENDPOINT, Access.SILENT, CARD), (), "silent by enp3s0", "power and cable"),
        (CameraProbe(ENDPOINT, Access.SILENT, CARD), (RIGHT,), "silent", "21900002 at 192.168.3.12"),
        (
            CameraProbe(ENDPOINT, Access.SILENT, replace(CARD, address="10.0.0.5")),
            (),
            "silent",
            "not in the subnet of any card",
        ),
        (CameraProbe(ENDPOINT, Access.REFUSED, CARD), (), "refused", "no camera"),
        (
            CameraProbe(ENDPOINT, Access.NO_WAY, reason="Network is unreachable"),
            (),
            "no way there: Network is unreachable",
            "an address in the camera's subnet",
        ),
        (replace(WELL, about=replace(LEFT, model="acA640-120gm")), (), "acA640-120gm", "Another device"),
        (replace(WELL, about=RIGHT), (replace(LEFT, address="192.168.3.12"),), "21900002", "swap the cables"),
        (replace(WELL, about=RIGHT), (), "21900002", "calibrate the head anew"),
        (
            replace(WELL, control=Control(True, "192.168.3.7", 40001), packet_bytes=None),
            (),
            "controlled by 192.168.3.7:40001",
            "on the other computer",
        ),
        (
            replace(WELL, control=Control(True, "192.168.3.1", 40001, PortUser(812, "pylon viewer"))),
            (),
            "controlled by pylon viewer (pid 812)",
            "End that program",
        ),
        (
            replace(WELL, control=Control(True, "192.168.3.1", 40001, here=True)),
            (),
            "controlled by 192.168.3.1:40001",
            "has ended, or is another user's",
        ),
        (replace(WELL, control=Control(True)), (), "another program, which it does not name", "heartbeat"),
        (replace(WELL, packet_bytes=None), (), "nobody in control", "switch it off and on"),
        (replace(WELL, packet_bytes=0), (), "nobody in control", "firewall"),
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
        "controlled from elsewhere",
        "controlled from here",
        "controlled from here, unseen",
        "controlled by somebody",
        "no control",
        "no test packets",
    ],
)
def test_what_is_not_well_has_a_cause_in_plain_words(
    probe: CameraProbe, found: tuple[About, ...], seen: str, advice: str
) -> None:
    verdict = judge(probe, found, LEFT.serial, MODEL)
    assert not verdict.well
    assert seen in verdict.seen
    assert advice in verdict.advice
    assert document(probe, verdict)["cause"] == verdict.advice


def test_small_packets_are_well_and_say_what_would_be_better() -> None:
    verdict = judge(replace(WELL, packet_bytes=1500, interface=replace(CARD, mtu_bytes=1500)))
    assert verdict.well
    assert "packets of 1500 bytes pass" in verdict.seen
    assert "enp3s0 has an MTU of 1500" in verdict.advice


# --- the probe ---------------------------------------------------------------------------------------------

MakePeer = Callable[..., Peer]


@pytest.fixture
def make_peer() -> Iterator[MakePeer]:
    made: list[Peer] = []

    def make(*arguments: str) -> Peer:
        made.append(Peer(*arguments))
        return made[-1].ready()

    yield make
    for peer in made:
        peer.close()


def probed(peer: Peer) -> CameraProbe:
    return probe_camera(Endpoint("gev", host=peer.address))


def test_a_camera_is_asked_measured_and_given_back(make_peer: MakePeer) -> None:
    peer = make_peer(SERIALS[0], "--largest-packet", "1500")
    for _ in range(2):  # the first look leaves nothing behind
        found = probed(peer)
        assert found.access is Access.ANSWERED
        assert found.about is not None
        assert (found.about.address, found.about.serial, found.about.model) == (
            peer.address,
            SERIALS[0],
            MODEL,
        )
        assert found.interface is not None
        assert found.interface.loopback
        assert found.control == Control(False)
        assert found.packet_bytes == 1500


def test_a_camera_that_somebody_controls_is_left_alone(make_peer: MakePeer) -> None:
    peer = make_peer(SERIALS[0])
    peer.fault("taken")
    found = probed(peer)
    assert found.control == Control(True)
    assert found.packet_bytes is None


def test_a_camera_without_test_packets_is_told(make_peer: MakePeer) -> None:
    assert probed(make_peer(SERIALS[0], "--largest-packet", "0")).packet_bytes == 0


def test_nobody_and_somebody_silent_are_told_apart() -> None:
    address = free_address()
    endpoint = Endpoint("gev", host=address)
    assert probe_camera(endpoint).access is Access.REFUSED
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind((address, GVCP_PORT))
        assert probe_camera(endpoint).access is Access.SILENT


def test_inside_this_computer_nothing_is_asked_outside() -> None:
    assert all(each.loopback for each, _ in found_around([parse_endpoint("gev://127.0.0.1")]))


# --- the report --------------------------------------------------------------------------------------------


def test_the_cameras_of_a_theatre_file_are_looked_at_and_their_cause_is_told(
    make_peer: MakePeer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = make_peer(SERIALS[0], "--largest-packet", "8192"), free_address()
    path = tmp_path / "theatre.toml"
    path.write_text(
        'schema = 1\ntheatre = "lab"\n[stereo]\ndriver = "basler_stereo"\n'
        f'endpoints = {{ left = "gev://{left.address}", right = "gev://{right}" }}\n'
        f'[stereo.options]\nleft_serial = "{SERIALS[0]}"\nright_serial = "{SERIALS[1]}"\n'
    )
    with pytest.raises(SystemExit) as ended:
        show(examine(path), as_json=True)
    assert ended.value.code == 4
    report = json.loads(capsys.readouterr().out)
    first, second = report["cameras"]
    assert (first["well"], first["packet_bytes"], first["camera"]["serial"]) == (True, 8192, SERIALS[0])
    assert (second["well"], second["access"], second["camera"]) == (False, "refused", None)
    device = report["findings"][-1]
    assert device["subject"] == "device stereo"
    assert "GEV-001" in device["seen"]
    assert device["advice"] == second["cause"]


def test_a_camera_that_does_not_answer_ends_with_4(capsys: pytest.CaptureFixture[str]) -> None:
    address = free_address()
    with pytest.raises(SystemExit) as ended:
        show(examine(None, [f"gev://{address}"]), as_json=False)
    assert ended.value.code == 4
    assert f"camera gev://{address}\tlook\trefused by lo" in capsys.readouterr().out
