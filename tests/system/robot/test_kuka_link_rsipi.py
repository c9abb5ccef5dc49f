"""The driver against a third-party controller: the echo server of RSIPI.

It writes two decimals and blanks before "/>", sends before anybody answers, and knows no EKI: that comes from
a small controller of the tests' own, or the link process is driven without the arm above it.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.resources import files
from math import radians
from pathlib import Path
from xml.etree import ElementTree

import pytest
from fake_controller import FakeController

from drivers.kuka_rsi import KukaRsiArm
from drivers.kuka_rsi.connections import start_link
from drivers.kuka_rsi.controller.generate import render
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES, LinkSettings
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm.pose import radians6
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.records import NO_DESCRIPTOR, LinkState, MotionResult, Move, OpenStream, StreamPhase
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.robot import JointMove
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.wire.kuka_context import DEFAULT_CONTEXT_FILE, context_hash, load_context

MODEL = kr6_r900("kr6_r900_sixx")
TARGET_DEG = (5.0, -2.0, 3.0, 1.0, 4.0, -6.0)
TARGET = radians6(*TARGET_DEG)
ECHO_DIGIT_DEG = 0.01  # the echo server rounds to that
HANG_S = 60.0
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

    client = parse_endpoint(own_udp_endpoint())
    text = Path(context("joints")).read_text("utf-8-sig")
    path = tmp_path / "joints.xml"
    path.write_text(text.replace("10.10.10.10", client.host).replace("64000", str(client.port)), "utf-8")
    return path


@pytest.fixture
def link(ethernet_file: Path) -> Iterator[LinkClient]:
    root = ElementTree.parse(ethernet_file).getroot()

    def tags(where: str) -> tuple[str, ...]:
        return tuple(str(e.get("TAG")) for e in root.findall(f"{where}/ELEMENTS/ELEMENT"))

    settings = LinkSettings(
        host=str(root.findtext("CONFIG/IP_NUMBER")),
        port=int(str(root.findtext("CONFIG/PORT"))),
        parent_pid=os.getpid(),
        mailbox_fd=NO_DESCRIPTOR,
        event_fd=NO_DESCRIPTOR,
        variant="kr6_r900_sixx",
        cycle_ms=4,
        sentype=str(root.findtext("CONFIG/SENTYPE")),
        send_tags=tags("SEND"),
        receive_tags=tags("RECEIVE"),
        axis_tags=tuple(f"AKorr.{axis}" for axis in AXIS_NAMES),
        stop_tag="",
        silence_limit_s=2.0,
        heartbeat_limit_s=5.0,
        settle_tolerance_deg=ECHO_DIGIT_DEG,
        real_time_priority=0,
    )
    client = start_link(settings)
    yield client
    client.close()


def _wait(link: LinkClient, condition: Callable[[LinkState], bool]) -> LinkState:
    state = link.wait(condition, 10.0)
    assert state is not None, link.state
    return state


def _await_echo_port() -> None:
    """The echo server's port is fixed, and tests run side by side."""
    deadline = time.monotonic() + HANG_S
    while time.monotonic() < deadline:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.bind(("0.0.0.0", ECHO_PORT))
            return
        time.sleep(0.05)
    pytest.skip(f"the echo server's fixed port {ECHO_PORT} is in use on this machine")


@contextmanager
def echo_server(ethernet_file: Path, folder: Path) -> Iterator[Callable[[], list[float]]]:
    """Runs it; the call ends it and gives the axes that it has come to, in deg."""
    _await_echo_port()
    with subprocess.Popen(
        [sys.executable, "-P", "-W", "ignore", "-c", SERVER, str(ethernet_file)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=folder,  # it writes a folder of logs
    ) as server:

        def end() -> list[float]:
            output, _ = server.communicate("stop\n", timeout=HANG_S)
            result = next(line for line in output.splitlines() if line.startswith("RESULT")).split()
            return [float(value) for value in result[2:]]

        try:
            yield end
        finally:
            server.kill()


def test_the_link_moves_the_arm_of_a_third_party_controller(
    link: LinkClient, ethernet_file: Path, tmp_path: Path
) -> None:
    with echo_server(ethernet_file, tmp_path) as end:
        _wait(link, lambda s: s.device_clock > 0 or s.rejected > 0 or s.received_ns > 0)
        time.sleep(0.05)  # telegrams that nobody answers yet
        link.command(OpenStream(working_limits(MODEL)))
        first = _wait(link, lambda s: s.phase is StreamPhase.RUNNING and s.settled)
        assert first.base_rad == (0.0,) * 6
        plan = plan_joint_move(MODEL, first.commanded_rad, TARGET, working_limits(MODEL))
        number = link.command(Move(plan))
        done = _wait(link, lambda s: s.command_number >= number and s.result is not MotionResult.RUNNING)
        assert done.result is MotionResult.DONE
        assert done.rejected == 0
        assert not done.fault
        axes_deg = end()
    assert axes_deg == pytest.approx(TARGET_DEG, abs=1e-5)


@pytest.fixture
def foreign_arm(tmp_path: Path) -> Iterator[tuple[KukaRsiArm, Path]]:
    """Our driver with the tags that the echo server knows, and the Ethernet file that we make for it."""
    pc = parse_endpoint(own_udp_endpoint())
    text = files("ronna_hw.wire").joinpath(DEFAULT_CONTEXT_FILE).read_text("utf-8")
    description = tmp_path / "context.toml"
    description.write_text(
        text.replace("AK.", "AKorr.")
        .replace("192.168.10.20", pc.host)
        .replace("pc_port = 59152", f"pc_port = {pc.port}")
    )
    context = load_context(description)
    ethernet_file = tmp_path / "ethernet.xml"
    ethernet_file.write_text(render(context)[f"{context.name}_eth.xml"])
    eki = FakeController()
    eki.streams = False
    eki.axes_deg = (0.0,) * 6  # where the echo server begins
    eki.facts["CtxHash"] = context_hash(context)
    config = DeviceConfig(
        driver="kuka_rsi",
        endpoints={"rsi": str(pc), "eki_project": f"tcp://127.0.0.1:{eki.eki_port}"},
        options={
            "context": str(description),
            "silence_limit_s": 2.0,
            "heartbeat_limit_s": 5.0,
            "settle_tolerance_deg": ECHO_DIGIT_DEG,
        },
    )
    arm = KukaRsiArm("robot.master", config, HostClock())
    yield arm, ethernet_file
    arm.close()
    eki.close()


def test_the_whole_driver_moves_the_arm_of_a_third_party_controller(
    foreign_arm: tuple[KukaRsiArm, Path], tmp_path: Path
) -> None:
    arm, ethernet_file = foreign_arm
    with echo_server(ethernet_file, tmp_path) as end:
        arm.connect()
        arm.configure()
        arm.activate()
        reading = arm.move(JointMove(TARGET))
        assert reading.joints_rad == pytest.approx(TARGET, abs=radians(ECHO_DIGIT_DEG))
        assert arm.link_statistics().rejected_telegrams == 0
        arm.deactivate()  # ended by EKI: the echo server knows no STOP object
        axes_deg = end()
    assert axes_deg == pytest.approx(TARGET_DEG, abs=ECHO_DIGIT_DEG)
