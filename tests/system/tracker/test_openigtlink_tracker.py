"""A tracker behind an OpenIGTLink server: a foreign server, our simulated one, and a case that cannot run."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from plus_server import make_tracker
from waiting import eventually

from ronna_hw.control_port import ask_control_port
from ronna_hw.devices.readings import Validity
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.frames import Frame
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.theatre import open_theatre
from ronna_hw.wire.openigtlink import Message, MessageReader, encode_message
from ronna_hw.wire.openigtlink_contents import Subscription, encode_subscription

pyigtl = pytest.importorskip("pyigtl")
PROGRAM = Path(__file__).parents[2] / "support" / "devices" / "pyigtl_tracker_program.py"
SERVED = ("polaris", "--endpoint", "igtl://127.0.0.1:0")


@pytest.fixture
def foreign_server() -> Iterator[tuple[str, Any]]:
    """Endpoint and standard input of a server that we did not write."""
    with subprocess.Popen(
        [sys.executable, "-P", str(PROGRAM)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        yield f"igtl://127.0.0.1:{process.stdout.readline().strip()}", process.stdin
        process.kill()


@pytest.fixture
def unit() -> Iterator[ChildProcess]:
    """The simulated unit on its bench, served as PlusServer serves one."""
    with ChildProcess("ronna-sim polaris", command("sim.cli", *SERVED)) as child:
        yield child


def test_a_foreign_servers_poses_keep_their_numbers(foreign_server: tuple[str, Any]) -> None:
    endpoint, words = foreign_server
    tracker = make_tracker(endpoint)
    with tracker.active():
        frames = [tracker.read_frame() for _ in range(20)]
        # It stamps each message by itself: those of one moment still belong together.
        assert sum(all(tool.validity is Validity.OK for tool in frame.tools) for frame in frames) >= 15
        pose = tracker.read_frame().tool("x_frame").transform(Frame.TRACKER, Frame.MARKER)
        assert pose.translation_mm == pytest.approx((100.0, 20.0, -1500.0), abs=0.5)
        x_axis = pose.apply([[1.0, 0.0, 0.0]])[0] - pose.translation_mm
        assert x_axis == pytest.approx([0.36, -0.8, 0.48], abs=1e-5)
        words.write("RobotFrameToTracker\n")
        words.flush()
        eventually(lambda: tracker.read_frame().tool("x_frame").validity is Validity.MISSING)
        assert tracker.read_frame().tool("robot_frame").validity is Validity.OK
    tracker.close()


def test_a_foreign_client_reads_the_simulated_server(unit: ChildProcess) -> None:
    address = parse_endpoint(unit.ready["endpoint"])
    client = pyigtl.OpenIGTLinkClient(host=address.host, port=address.port)
    tracker = make_tracker(unit.ready["endpoint"], tools=BENCH_TOOL)
    with tracker.active():
        ours = tracker.read_frame().tools[0]
        theirs = client.wait_for_message("RobotFrameToTracker", timeout=10)
    assert theirs.matrix[:3, 3] == pytest.approx(ours.position_mm, abs=1.0)
    client.stop()
    tracker.close()


BENCH_TOOL = [{"name": "robot_frame", "markers_mm": [[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 70.0, 0.0]]}]


def test_the_simulated_server_keeps_the_rules_of_plus(unit: ChildProcess) -> None:
    address = parse_endpoint(unit.ready["endpoint"])
    with socket.create_connection((address.host, address.port)) as peer:
        messages = read_messages(peer)
        assert {next(messages).version for _ in range(10)} == {1}
        once_a_second = encode_subscription(Subscription(1, ""))  # meant as a millisecond
        peer.sendall(encode_message("CLIENTINFO", "", b"<ClientInfo/>"))
        peer.sendall(encode_message("STT_TDATA", "", once_a_second))
        kinds = [message.kind for message in until_status(messages, 4)]
        assert kinds.count("RTS_TDATA") == 1
        assert kinds.count("TDATA") in (1, 2)
        assert kinds.count("TRANSFORM") > 10
        peer.sendall(encode_message("GET_STATUS", "", version=2))
        newer = next(message for message in messages if message.version == 2 and message.kind == "TRANSFORM")
        assert newer.metadata["IGTL_DEVICE_NAME"] == newer.name == "RobotFrameToTracker"
        assert newer.metadata["TransformStatus"] == "OK"


def read_messages(peer: socket.socket) -> Iterator[Message]:
    reader = MessageReader()
    while data := peer.recv(4096):
        yield from reader.feed(data)


def until_status(messages: Iterator[Message], count: int) -> Iterator[Message]:
    """Messages until this many STATUS have come, four of which come in a second."""
    for message in messages:
        yield message
        count -= message.kind == "STATUS"
        if not count:
            return


def test_a_hidden_tool_of_the_simulated_server_is_missing_and_comes_back(unit: ChildProcess) -> None:
    tracker = make_tracker(unit.ready["endpoint"], tools=BENCH_TOOL)
    with tracker.active():
        for line, validity in (
            ("tracker occlude tool robot_frame for 0.3 s", Validity.MISSING),
            (None, Validity.OK),
        ):
            if line:
                ask_control_port(unit.ready["control"], "fault", line=line)
            eventually(lambda validity=validity: tracker.read_frame(5.0).tools[0].validity is validity)
    tracker.close()


@pytest.mark.slow
def test_the_driver_passes_the_suite_against_the_simulated_server(commands: Any) -> None:
    run = commands.run(
        "ronna-conformance", "tracker", "--sim", "--driver", "openigtlink_tracker", "--json", timeout_s=120.0
    )
    report = json.loads(run.stdout)
    outcomes = {case["number"]: case["outcome"] for case in report["cases"]}
    assert {number for number, outcome in outcomes.items() if outcome == "FAIL"} == set()
    assert {number for number, outcome in outcomes.items() if outcome == "SKIP"} == {"T11", "T12", "T22"}


@pytest.mark.slow
def test_single_spheres_are_refused_before_the_first_step(commands: Any, tmp_path: Path) -> None:
    run = commands.run(
        "ronna-procedure", "run", "--sim", "--scene", "mini", "--tracker", "plus",
        "--out", str(tmp_path / "runs"),
    )  # fmt: skip
    assert run.returncode == 2
    assert "CLI-001" in run.stderr
    assert "--fiducials xframe" in run.stderr
    assert "done" not in run.stdout + run.stderr


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_whole_phantom_case_runs_with_the_x_shaped_frame(commands: Any, tmp_path: Path) -> None:
    run = commands.run(
        "ronna-procedure", "run", "--sim", "--scene", "mini", "--fiducials", "xframe", "--tracker", "plus",
        "--out", str(tmp_path / "runs"), timeout_s=500.0,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    (target,) = json.loads(commands.run("ronna-sim", "verify", str(folder), "--json").stdout)["targets"]
    assert target["application_error_mm"] < 1.0


def test_open_theatre_reads_a_served_tracker(tmp_path: Path, unit: ChildProcess) -> None:
    file = tmp_path / "theatre.toml"
    file.write_text(
        'schema = 1\ntheatre = "bench"\nbanner = "SIMULATED THEATRE"\n[tracker]\n'
        f'driver = "openigtlink_tracker"\nendpoint = "{unit.ready["endpoint"]}"\n'
        "[[tracker.options.tools]]\n"
        'name = "robot_frame"\nmarkers_mm = [[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 70.0, 0.0]]\n'
    )
    with open_theatre(file) as theatre, theatre.tracker.active() as tracker:
        assert tracker.read_frame().tool("robot_frame").validity is Validity.OK
