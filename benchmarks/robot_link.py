"""The robot link measured: round trips beside a bare echo, and what is done between telegrams.

`python -P benchmarks/robot_link.py [--cycles N]` prints a table and, with --json FILE, writes the figures.
Round trips are paced, one telegram per millisecond, over UDP on this machine; nothing else should run.
"""

from __future__ import annotations

import json
import os
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from drivers.kuka_rsi.link_client import LinkClient
from drivers.kuka_rsi.mailbox import CommandKind, Phase
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.set_points import Choice, SetPoints
from drivers.kuka_rsi.stream import link_settings
from ronna_hw.arm.inverse import branch_of, solutions, solve_branch
from ronna_hw.arm.kinematics import forward
from ronna_hw.arm.limits import working_limits
from ronna_hw.arm.model import arm_model, radians6
from ronna_hw.arm.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.endpoints import Endpoint
from ronna_hw.wire.kuka_context import load_context

PACE_S = 0.001
WARM_UP = 500
MODEL = arm_model("kr6_r900_sixx")
START = radians6(0, -90, 90, 0, 60, 0)
ECHO = """
import socket, sys
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind(("127.0.0.1", int(sys.argv[1])))
print("ready", flush=True)
while True:
    data, address = link.recvfrom(8192)
    link.sendto(data[-150:], address)
"""
TELEGRAM = (
    b'<Rob Type="KUKA"><RIst X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000" C="180.0000"/>'
    b'<AIPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="60.0000" A6="0.0000"/>'
    b'<EIPos E1="0.0000" E2="0.0000" E3="0.0000" E4="0.0000" E5="0.0000" E6="0.0000"/>'
    b'<Delay D="0"/><IPOC>%d</IPOC></Rob>'
)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _round_trips(port: int, cycles: int) -> list[float]:
    times = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.settimeout(1.0)
        for k in range(cycles + WARM_UP):
            telegram = TELEGRAM % (1000 + 4 * k)
            begun = time.perf_counter()
            controller.sendto(telegram, ("127.0.0.1", port))
            controller.recv(8192)
            if k >= WARM_UP:
                times.append((time.perf_counter() - begun) * 1e6)
            time.sleep(PACE_S)
    return times


def echo_round_trips(cycles: int) -> list[float]:
    """A Python process that sends back what it gets."""
    port = _free_port()
    with subprocess.Popen(
        [sys.executable, "-P", "-c", ECHO, str(port)], stdout=subprocess.PIPE, text=True
    ) as echo:
        assert echo.stdout is not None
        echo.stdout.readline()
        times = _round_trips(port, cycles)
        echo.kill()
    return times


def link_round_trips(cycles: int, priority: int) -> list[float]:
    """The real-time process with an open session, arm at rest."""
    rsi = Endpoint("udp", host="127.0.0.1", port=_free_port())
    options = KukaOptions(silence_limit_s=5.0, heartbeat_limit_s=5.0, real_time_priority=priority)
    link = LinkClient(link_settings(rsi, load_context(), options))
    try:
        link.command(CommandKind.OPEN)
        link.wait(lambda s: s.phase is Phase.ARMED, 2.0)
        return _round_trips(rsi.port, cycles)
    finally:
        link.close()


def preparation_times(plan: MotionPlan) -> list[float]:
    """Everything between two telegrams that depends on the motion: both points, judged."""
    points = SetPoints(MODEL, working_limits(MODEL), 0.004, plan.start_rad)
    points.start(plan, 1.0)
    times = []
    while points.moving:
        begun = time.perf_counter()
        points.prepare()
        points.commit(Choice.GO)
        times.append((time.perf_counter() - begun) * 1e6)
    return times


def _repeated(call: Callable[[], object], count: int = 5000) -> list[float]:
    times = []
    for _ in range(count):
        begun = time.perf_counter()
        call()
        times.append((time.perf_counter() - begun) * 1e6)
    return times


def measure(
    cycles: Annotated[int, typer.Option(help="Telegrams per peer.")] = 5000,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures here.")] = None,
) -> None:
    """Measure and print."""
    limits = working_limits(MODEL)
    here = forward(MODEL, START)
    x, y, z = here.position_mm
    line = plan_line(MODEL, START, Pose((x - 60, y + 80, z - 60), here.rotation), limits, (0.0, 0.0, 200.0))
    joint = plan_joint_move(MODEL, START, radians6(40, -60, 60, 30, 80, 90), limits)
    branch = branch_of(MODEL, START)
    rows = {
        "round trip, bare echo": echo_round_trips(cycles),
        "round trip, link process": link_round_trips(cycles, 0),
        "round trip, link process, SCHED_FIFO": link_round_trips(cycles, 80),
        "round trip, bare echo again": echo_round_trips(cycles),
        "preparation, joint move": preparation_times(joint),
        "preparation, straight line": preparation_times(line),
        "inverse kinematics, all branches": _repeated(lambda: solutions(MODEL, here)),
        "inverse kinematics, one branch": _repeated(lambda: solve_branch(MODEL, here, branch, START)),
        "forward kinematics": _repeated(lambda: forward(MODEL, START)),
        "plan of a straight line": _repeated(
            lambda: plan_line(MODEL, START, Pose((x, y, z - 60), here.rotation), limits), 200
        ),
    }
    figures = {}
    print(f"{'microseconds':40} {'p50':>9} {'p99':>9} {'max':>10}   n    load {os.getloadavg()[0]:.1f}")
    for name, times in rows.items():
        ordered = sorted(times)
        p50, p99 = statistics.median(ordered), ordered[int(0.99 * (len(ordered) - 1))]
        figures[name] = {"p50_us": p50, "p99_us": p99, "max_us": ordered[-1], "n": len(ordered)}
        print(f"{name:40} {p50:9.1f} {p99:9.1f} {ordered[-1]:10.1f}   {len(ordered)}")
    if json_file is not None:
        json_file.write_text(json.dumps({"load": os.getloadavg()[0], "figures": figures}, indent=1))


if __name__ == "__main__":
    typer.run(measure)
