"""The real-time link against a controller that we did not write: the echo server of RSIPI.

It writes two decimals and blanks before "/>", sends before anybody answers, and knows no EKI: so the link
process is driven here without the arm driver above it.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from math import degrees
from pathlib import Path
from xml.etree import ElementTree

import pytest

from drivers.kuka_rsi.link_client import LinkClient
from drivers.kuka_rsi.link_state import CommandKind, LinkState, Phase, Result
from drivers.kuka_rsi.settings import AXIS_NAMES, LinkSettings
from ronna_hw.arm.limits import working_limits
from ronna_hw.arm.model import arm_model, radians6
from ronna_hw.arm.planning import plan_joint_move

MODEL = arm_model("kr6_r900_sixx")
TARGET = radians6(5.0, -2.0, 3.0, 1.0, 4.0, -6.0)
ECHO_PORT = 50000  # fixed in the echo server

SERVER = """
import sys, time
from RSIPI.rsi_echo_server import EchoServer

server = EchoServer(sys.argv[1], delay_ms=4, mode="absolute", timeout_packets=1000)
server.start()
sys.stdin.readline()
server.stop()
pose = server.state["AIPos"]
print("RESULT", server.faulty_packets, *(pose[axis] for axis in ("A1", "A2", "A3", "A4", "A5", "A6")))
"""


@pytest.fixture
def ethernet_file(tmp_path: Path) -> Path:
    """RSIPI's own `joints` file, with an address that is free here."""
    from RSIPI import context  # type: ignore[import-untyped]

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    text = Path(context("joints")).read_text("utf-8-sig")
    path = tmp_path / "joints.xml"
    path.write_text(text.replace("10.10.10.10", "127.0.0.1").replace("64000", str(port)), "utf-8")
    return path


@pytest.fixture
def link(ethernet_file: Path) -> Iterator[LinkClient]:
    root = ElementTree.parse(ethernet_file).getroot()

    def settings(mailbox_fd: int, event_fd: int) -> LinkSettings:
        def tags(where: str) -> tuple[str, ...]:
            return tuple(str(e.get("TAG")) for e in root.findall(f"{where}/ELEMENTS/ELEMENT"))

        return LinkSettings(
            host="127.0.0.1",
            port=int(str(root.findtext("CONFIG/PORT"))),
            parent_pid=os.getpid(),
            mailbox_fd=mailbox_fd,
            event_fd=event_fd,
            variant="kr6_r900_sixx",
            cycle_ms=4,
            sentype=str(root.findtext("CONFIG/SENTYPE")),
            send_tags=tags("SEND"),
            receive_tags=tags("RECEIVE"),
            axis_tags=tuple(f"AKorr.{axis}" for axis in AXIS_NAMES),
            stop_tag="",
            silence_limit_s=2.0,
            heartbeat_limit_s=5.0,
            settle_tolerance_deg=0.01,  # the echo server rounds to that
            speed_fraction=0.12,
            real_time_priority=0,
        )

    client = LinkClient(settings)
    yield client
    client.close()


def _wait(link: LinkClient, condition: Callable[[LinkState], bool]) -> LinkState:
    state = link.wait(condition, 10.0)
    assert state is not None, link.state
    return state


def _port_is_taken() -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", ECHO_PORT))
        except OSError:
            return True
    return False


def test_the_link_moves_the_arm_of_a_foreign_controller(
    link: LinkClient, ethernet_file: Path, tmp_path: Path
) -> None:
    if _port_is_taken():
        pytest.skip(f"the echo server's fixed port {ECHO_PORT} is in use on this machine")
    with subprocess.Popen(
        [sys.executable, "-P", "-W", "ignore", "-c", SERVER, str(ethernet_file)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,  # it writes a folder of logs
    ) as server:
        _wait(link, lambda s: s.IPOC > 0 or s.rejected > 0 or s.received_ns > 0)
        time.sleep(0.05)  # telegrams that nobody answers yet
        link.command(CommandKind.OPEN)
        first = _wait(link, lambda s: s.phase is Phase.RUNNING and s.settled)
        assert first.base_rad == (0.0,) * 6
        plan = plan_joint_move(MODEL, first.commanded_rad, TARGET, working_limits(MODEL))
        number = link.command(CommandKind.MOVE, plan)
        done = _wait(link, lambda s: s.command_number >= number and s.result is not Result.RUNNING)
        assert done.result is Result.DONE
        assert done.rejected == 0
        assert not done.fault
        output, _ = server.communicate("stop\n", timeout=10)
    result = next(line for line in output.splitlines() if line.startswith("RESULT")).split()
    assert [float(v) for v in result[2:]] == pytest.approx([degrees(v) for v in TARGET], abs=1e-5)
