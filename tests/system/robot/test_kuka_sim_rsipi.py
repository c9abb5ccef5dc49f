"""The robot controller driven by RSIPI, a third-party client, with the contexts it ships."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.wire.kuka_context import AXISCORR_DEFAULT_LIMIT_DEG

STEPS, STEP_DEG = 100, 0.03  # of A1
CLIENT = """
import json, sys, time
from RSIPI import RSIAPI
from RSIPI.fault_injection import suspended

config, mode, stall_s = sys.argv[1:4]
with RSIAPI(config, rsi_mode=mode) as api:
    api.start()
    assert api.wait_for_connection(10)
    first = dict(api.client.send_variables["AIPos"])
    pose = dict(api.client.send_variables["RIst"])

    def cycles(count):
        for _ in range(count):
            sequence = api.client.publish_corrections({})
            api.client.wait_correction_applied(sequence)

    def axis(offset):
        sequence = api.client.publish_corrections({"AKorr": {"A1": offset, "A6": -offset}})
        assert api.client.wait_correction_applied(sequence, timeout=2.0)

    cycles(10)
    begun_ms = api.client.current_ipoc()
    for n in range(1, 101):
        if n == 50 and float(stall_s):
            with suspended(api.client.network_process.pid):
                time.sleep(float(stall_s))
        axis(0.03 * n if mode == "absolute" else 0.03)
    if mode == "relative":
        axis(0.0)
    taken_ms = api.client.current_ipoc() - begun_ms
    cycles(120)
    result = {
        "first": first,
        "last": dict(api.client.send_variables["AIPos"]),
        "set": dict(api.client.send_variables["ASPos"]),
        "pose": pose,
        "moved": dict(api.client.send_variables["RIst"]),
        "cycles": taken_ms // 4,
        "late": api.client.send_variables["Delay"]["D"],
    }
    print(json.dumps(result))
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """RSIPI's own `joints` context file, with an address that is free here."""
    from RSIPI import context

    client = parse_endpoint(own_udp_endpoint())
    text = Path(context("joints")).read_text("utf-8-sig")
    path = tmp_path / "joints.xml"
    path.write_text(text.replace("10.10.10.10", client.host).replace("64000", str(client.port)), "utf-8")
    return path


@contextmanager
def simulator(config: Path, mode: str, *options: str) -> Iterator[ChildProcess]:
    free = "tcp://127.0.0.1:0"
    more = ("--corrections", mode, "--eki", free, "--eki-project", free, "--autostart", *options)
    with ChildProcess(
        "ronna-sim kuka", command("sim.cli", "kuka", "--rsi-config", str(config), *more)
    ) as child:
        yield child


def run_client(config: Path, mode: str, stall_s: float = 0.0) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", CLIENT, str(config), mode, str(stall_s)],
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("mode", ["absolute", pytest.param("relative", marks=pytest.mark.slow)])
def test_rsipi_moves_the_arm(config: Path, mode: str) -> None:
    with simulator(config, mode) as child:
        assert child.ready["wiring"] == "inferred"
        assert child.ready["wired"] == ["AXISCORR", "POSCORR"]
        seen = run_client(config, mode)
    moved = {axis: seen["last"][axis] - seen["first"][axis] for axis in seen["first"]}
    # Where the client's host stalls, a delta acts again: in a cycle that is answered with it once more, and
    # in one whose reply is late, by HOLDON 1; their sum ends at AXISCORR's limit.
    most = STEPS if mode == "absolute" else seen["cycles"] + seen["late"]
    steps = round(moved["A1"] / STEP_DEG)
    assert STEPS <= steps <= most
    assert moved["A1"] == pytest.approx(min(steps * STEP_DEG, AXISCORR_DEFAULT_LIMIT_DEG), abs=1e-3)
    assert moved["A6"] == pytest.approx(-moved["A1"], abs=1e-3)
    assert moved["A2"] == moved["A3"] == moved["A4"] == moved["A5"] == 0.0
    assert seen["set"] == seen["first"]
    assert seen["moved"]["Y"] != seen["pose"]["Y"]


@pytest.mark.slow
def test_an_absolute_correction_arrives_despite_lost_replies_and_a_stalling_client(
    config: Path, tmp_path: Path
) -> None:
    faults = tmp_path / "faults"
    faults.write_text("at 0 s: robot drop 20 %\nat 0 s: robot duplicate 20 %\n")
    with simulator(config, "absolute", "--faults", str(faults)):
        seen = run_client(config, "absolute", stall_s=0.15)
    assert seen["last"]["A1"] - seen["first"]["A1"] == pytest.approx(3.0, abs=1e-3)
    assert seen["late"] > 20


@pytest.mark.parametrize("name", ["Basic", "Full", "Joints", "Max", "OnlySend", "Stop"])
def test_every_context_that_rsipi_ships_is_understood(name: str) -> None:
    from RSIPI import context

    from sim.kuka.rsi.ethernet_file import read_ethernet_file
    from sim.kuka.rsi.telegrams import TelegramWriter

    path = Path(context("joints")).with_name(f"RSI_EthernetConfig_{name}.xml")
    said = read_ethernet_file(path, None, 255)
    telegram = TelegramWriter(said.send, 4, (0.0,) * 6, (0.0,) * 6).write((1.0,) * 6, (2.0,) * 6, 3, 4)
    tags = {element.tag.removeprefix("DEF_").partition(".")[0] for element in said.send} - {"FREE"}
    assert {child.tag for child in ElementTree.fromstring(telegram)} == {*tags, "IPOC"}
    assert said.ethernet.only_send is (name == "OnlySend")


@pytest.mark.slow
def test_the_next_client_is_served_after_one_was_killed(config: Path) -> None:
    with simulator(config, "absolute") as child:
        with subprocess.Popen(
            [sys.executable, "-P", "-c", KILLED_CLIENT, str(config)], stdout=subprocess.PIPE, text=True
        ) as first:
            assert first.stdout is not None
            assert first.stdout.readline() == "connected\n"
            first.kill()
        seen = run_client(config, "absolute")
        assert child.alive
    assert seen["last"]["A1"] - seen["first"]["A1"] == pytest.approx(3.0, abs=1e-3)


KILLED_CLIENT = """
import socket, sys
from xml.etree import ElementTree

root = ElementTree.parse(sys.argv[1])
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind((root.findtext("CONFIG/IP_NUMBER"), int(root.findtext("CONFIG/PORT"))))
for n in range(50):
    data, source = link.recvfrom(8192)
    ipoc = data[data.rfind(b"<IPOC>"):data.rfind(b"</Rob>")]
    link.sendto(b'<Sen Type="ImFree">' + ipoc + b"</Sen>", source)
print("connected", flush=True)
while True:
    data, source = link.recvfrom(8192)
"""
