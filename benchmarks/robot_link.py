"""The robot link: cycles per second in lock-step beside a bare exchange, and turnaround beside its peers."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median

from benchmarks.contest import contest, family_cpu_s, process_cpu_s
from benchmarks.controller_probe import ControllerProbe, bare_telegram
from benchmarks.figures import Figure, compared
from benchmarks.robot_cell import RobotCell, peer
from ronna_hw.devices.readings import JointVector

ETHERNET_FILE = (
    Path(__file__).parents[1] / "drivers" / "kuka_rsi" / "controller" / "files" / "ronna_rsi_eth.xml"
)
LOCK_STEP_ROUNDS = 20
SWING_RAD = 0.6
BARE_EXCHANGES = 1000
TURNAROUND_ROUNDS = 10
TELEGRAMS_PER_BLOCK = 500
PACE_S = 0.001
ECHO, LINK_AT_REST, LINK_MOVING, RSIPI = "bare UDP echo", "driver at rest", "driver moving", "RSIPI"


def measure() -> list[Figure]:
    """Both measurements."""
    return [*_lock_step(), *_turnaround()]


def _lock_step() -> list[Figure]:
    with RobotCell() as cell, peer("udp_echo") as echo:
        home = cell.arm.read_state().joints_rad
        away: JointVector = (home[0] + SWING_RAD, *home[1:])
        ends = [away, home]
        link_pid = cell.arm._ways.open_link._process.pid if cell.arm._ways.open_link else 0
        pids = {"simulator": cell.controller.process.pid, "driver's process": link_pid}
        spent = {name: 0.0 for name in pids}
        cycles_seen = 0

        def move() -> float:
            nonlocal cycles_seen
            before = {name: process_cpu_s(pid) for name, pid in pids.items()}
            cycles, began = cell.arm.link_statistics().cycles, time.perf_counter()
            cell.arm.move_joints(ends[0])
            ends.reverse()
            elapsed = time.perf_counter() - began
            cycles = cell.arm.link_statistics().cycles - cycles
            for name, pid in pids.items():
                spent[name] += process_cpu_s(pid) - before[name]
            cycles_seen += cycles
            return cycles / elapsed

        probe = ControllerProbe(int(echo.ready["port"]))

        def exchange() -> float:
            began = time.perf_counter()
            for _ in range(BARE_EXCHANGES):
                probe.exchange(bare_telegram())
            return BARE_EXCHANGES / (time.perf_counter() - began)

        baseline = "bare UDP exchange"
        samples = contest({"simulator and driver": move, baseline: exchange}, LOCK_STEP_ROUNDS)
        probe.close()
        figures = compared("lock-step cycles per second", "1/s", samples, baseline)
        for name, cpu_s in spent.items():
            figures.append(Figure("CPU per lock-step cycle", name, cpu_s / cycles_seen * 1e6, "µs"))
        return figures


def _turnaround() -> list[Figure]:
    """5,000 telegrams each, 1 ms apart, as a controller sees it: telegram sent to matching reply read."""
    with ExitStack() as stack:
        peers = {
            ECHO: stack.enter_context(peer("udp_echo")),
            LINK_AT_REST: stack.enter_context(peer("rsi_link", "rest")),
            LINK_MOVING: stack.enter_context(peer("rsi_link", "move")),
            RSIPI: stack.enter_context(peer("rsipi_client", str(ETHERNET_FILE))),
        }
        probes = {
            name: stack.enter_context(ControllerProbe(int(child.ready["port"])))
            for name, child in peers.items()
        }
        cpu_s = dict.fromkeys(peers, 0.0)

        def block(name: str) -> float:
            pid = peers[name].process.pid
            before_s = family_cpu_s(pid)
            found = median(probes[name].block(TELEGRAMS_PER_BLOCK, PACE_S))
            cpu_s[name] += family_cpu_s(pid) - before_s
            return found

        samples = contest({name: partial(block, name) for name in peers}, TURNAROUND_ROUNDS)
        figures = compared("turnaround at 1 ms", "µs", samples, ECHO, scale=1e6)
        per_telegram = {name: [cpu_s[name] / len(probes[name].turnarounds_s)] for name in peers}
        return [
            *(_with_tail(figure, probes[figure.who]) for figure in figures),
            *compared("CPU per telegram, all processes", "µs", per_telegram, ECHO, scale=1e6),
        ]


def _with_tail(figure: Figure, probe: ControllerProbe) -> Figure:
    """The tail goes into the JSON, to look at and not to judge by: it belongs to the machine."""
    ordered = sorted(probe.turnarounds_s)
    tail = {
        "p90_us": ordered[int(0.90 * len(ordered))] * 1e6,
        "p99_us": ordered[int(0.99 * len(ordered))] * 1e6,
        "telegrams": float(len(ordered)),
        "unanswered": float(probe.unanswered),
        "moved_deg": probe.moved_deg,
    }
    return replace(figure, more=tail)
