"""The robot controller driven by RSIPI, a client that we did not write, with the contexts it ships."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ronna_hw.child_process import ChildProcess, command

CLIENT = """
import json, sys
from RSIPI import RSIAPI

config, mode = sys.argv[1:3]
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
        assert api.client.wait_correction_applied(sequence)

    cycles(10)
    for n in range(1, 101):
        axis(0.03 * n if mode == "absolute" else 0.03)
    if mode == "relative":
        axis(0.0)
    cycles(120)
    result = {
        "first": first,
        "last": dict(api.client.send_variables["AIPos"]),
        "set": dict(api.client.send_variables["ASPos"]),
        "pose": pose,
        "moved": dict(api.client.send_variables["RIst"]),
        "late": api.client.send_variables["Delay"]["D"],
    }
    print(json.dumps(result))
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """RSIPI's own `joints` context file, with an address that is free here."""
    from RSIPI import context

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    text = Path(context("joints")).read_text("utf-8-sig")
    path = tmp_path / "joints.xml"
    path.write_text(text.replace("10.10.10.10", "127.0.0.1").replace("64000", str(port)), "utf-8")
    return path


@contextmanager
def simulator(config: Path, mode: str) -> Iterator[ChildProcess]:
    free = "tcp://127.0.0.1:0"
    arguments = ("--rsi-config", str(config), "--corrections", mode, "--eki", free, "--eki-project", free)
    with ChildProcess("ronna-sim kuka", command("sim.cli", "kuka", *arguments, "--autostart")) as child:
        yield child


def run_client(config: Path, mode: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", CLIENT, str(config), mode],
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("mode", ["absolute", "relative"])
def test_rsipi_moves_the_arm(config: Path, mode: str) -> None:
    with simulator(config, mode) as child:
        assert child.ready["wiring"] == "inferred"
        assert child.ready["wired"] == ["AXISCORR", "POSCORR"]
        seen = run_client(config, mode)
    moved = {axis: seen["last"][axis] - seen["first"][axis] for axis in seen["first"]}
    # With HOLDON 1 every reply that a stalled host misses repeats the last delta: then it is longer.
    longest = 3.001 if mode == "absolute" else 4.9
    assert 2.999 < moved["A1"] < longest
    assert moved["A6"] == pytest.approx(-moved["A1"], abs=1e-3)
    assert moved["A2"] == moved["A3"] == moved["A4"] == moved["A5"] == 0.0
    assert seen["set"] == seen["first"]
    assert seen["moved"]["Y"] != seen["pose"]["Y"]


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
link.bind(("127.0.0.1", int(root.findtext("CONFIG/PORT"))))
for n in range(50):
    data, source = link.recvfrom(8192)
    ipoc = data[data.rfind(b"<IPOC>"):data.rfind(b"</Rob>")]
    link.sendto(b'<Sen Type="ImFree">' + ipoc + b"</Sen>", source)
print("connected", flush=True)
while True:
    data, source = link.recvfrom(8192)
"""
