"""The controller takes its behaviour from its two files: layout and peer from the Ethernet file, wiring,
limits, Timeout and Precision from the context."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from importlib.resources import files
from math import cos, pi
from pathlib import Path

import pytest

from ronna_hw.host.child_process import ChildProcess, command
from sim.world.world import World

FREE = "tcp://127.0.0.1:0"
LIMIT_S = 30.0
TIMEOUT_PACKETS, LIMIT_DEG = 20, 2.0
IPOC = re.compile(rb"<IPOC>(\d+)</IPOC></Rob>$")

ETHERNET_FILE = """<ROOT>
  <CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>{port}</PORT><SENTYPE>Ours</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>
  <SEND><ELEMENTS>
    <ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/>
    <ELEMENT TAG="DEF_ASPos" TYPE="DOUBLE" INDX="INTERNAL"/>
    <ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"/>
    <ELEMENT TAG="Clamped" TYPE="LONG" INDX="3"/>
  </ELEMENTS></SEND>
  <RECEIVE><ELEMENTS>
    <ELEMENT TAG="Wrist.Turn" TYPE="DOUBLE" INDX="7" HOLDON="1"/>
    <ELEMENT TAG="Leave" TYPE="BOOL" INDX="1" HOLDON="0"/>
    {others}
  </ELEMENTS></RECEIVE>
</ROOT>"""
OTHERS = "\n".join(f'<ELEMENT TAG="Others.V{n}" TYPE="DOUBLE" INDX="{n}" HOLDON="1"/>' for n in range(2, 7))


@pytest.fixture
def client() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.settimeout(LIMIT_S)
        yield link


@pytest.fixture
def controller(client: socket.socket, tmp_path: Path, lock_step_world: World) -> Iterator[ChildProcess]:
    ethernet, context = tmp_path / "link.xml", tmp_path / "context.toml"
    ethernet.write_text(ETHERNET_FILE.format(port=client.getsockname()[1], others=OTHERS))
    text = files("ronna_hw.wire").joinpath("kuka_rsi_context.toml").read_text("utf-8")
    limits = f'limits = "explicit"\nlower_deg = {[-LIMIT_DEG] * 6}\nupper_deg = {[LIMIT_DEG] * 6}\n'
    for old, new in (
        ("timeout_packets = 100", f"timeout_packets = {TIMEOUT_PACKETS}"),
        ("precision = 4", "precision = 2"),
        ('[axis_correction]\nlimits = "software_end_switches"\n', f"[axis_correction]\n{limits}"),
        ("[stop]", '[[feedback]]\nindx = 3\nobject = "AXISCORR"\n\n[stop]'),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    text = text.replace("[[receive]]", '[[send]]\ntag = "Clamped"\ntype = "LONG"\nindx = 3\n\n[[receive]]', 1)
    context.write_text(text)
    arguments = ["--rsi-config", str(ethernet), "--rsi-context", str(context), "--autostart"]
    arguments += ["--world", lock_step_world.endpoint]
    with ChildProcess(
        "ronna-sim kuka",
        command("sim.cli", "kuka", *arguments, "--eki", FREE, "--eki-project", FREE),
    ) as child:
        yield child


def exchange(client: socket.socket, turn_deg: float) -> bytes:
    """One telegram and its reply; the telegram."""
    telegram, source = client.recvfrom(8192)
    found = IPOC.search(telegram)
    assert found is not None
    reply = (
        f'<Sen Type="Ours"><Leave>0</Leave><Wrist Turn="{turn_deg:.6f}"/>'
        f"<IPOC>{found[1].decode()}</IPOC></Sen>"
    )
    client.sendto(reply.encode(), source)
    return telegram


def test_layout_peer_wiring_limits_timeout_and_precision_come_from_the_files(
    client: socket.socket, controller: ChildProcess, lock_step_world: World
) -> None:
    lock_step_world.clock.let_pass(60.0)  # at a correction that is clamped the controller rests otherwise
    said = {key: controller.ready[key] for key in ("wiring", "timeout_packets", "precision")}
    assert said == {"wiring": "context", "timeout_packets": TIMEOUT_PACKETS, "precision": 2}
    first = exchange(client, 0.0)
    axes = rb'( A\d="-?\d+\.\d\d"){6}'
    assert re.fullmatch(
        rb'<Rob Type="KUKA"><Delay D="0"/><ASPos' + axes + rb"/><AIPos" + axes + rb"/><Clamped>0</Clamped>"
        rb"<IPOC>\d+</IPOC></Rob>",
        first,
    )
    for n in range(1, 401):  # A6 by a tag of any name, and no further than the context allows
        exchange(client, 1.5 * LIMIT_DEG * (0.5 - 0.5 * cos(pi * n / 400)))
    for _ in range(100):
        last = exchange(client, 1.5 * LIMIT_DEG)

    def wrist_deg(telegram: bytes) -> float:
        return float(telegram.split(b"<AIPos")[1].split(b'A6="')[1].split(b'"')[0])

    assert wrist_deg(last) - wrist_deg(first) == pytest.approx(LIMIT_DEG, abs=0.01)
    assert b"<Clamped>65</Clamped>" in last  # bit 0, and bit 6 for A6
    assert first.split(b"<AIPos")[0].split(b"<ASPos")[1] == last.split(b"<AIPos")[0].split(b"<ASPos")[1]
    # A wrong Type is no reply: the run ends at the context's Timeout. The next one has another port.
    telegram, ours = client.recvfrom(8192)
    unanswered = 1
    while (source := client.recvfrom(8192)[1]) == ours:
        client.sendto(telegram.replace(b"Rob", b"Sen"), source)
        unanswered += 1
    assert unanswered == TIMEOUT_PACKETS
