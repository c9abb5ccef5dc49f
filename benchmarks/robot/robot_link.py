"""Robot link against bare exchanges and peers, with the machine's other processor idle or busy.

Lock-step: cycles per second through simulator and driver while the arm moves, by the driver's own record;
and of whole moves, including planning, during which there are no telegrams. Turnaround: telegram sent to
matching reply read, as seen by a controller, 1 ms and 4 ms apart. Goals are compared with an echo measured
in the same minutes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median

from benchmarks.figures import Figure, compare_samples, family_cpu_s, process_cpu_s, run_contest
from benchmarks.robot.robot_cell import ControllerProbe, RobotCell, bare_telegram, peer
from benchmarks.robot.turnaround import MEDIAN_ABOVE_ECHO_GOAL_US, compare_with_echo
from ronna_hw.arm_stream.records import RecordedCycle
from ronna_hw.devices.robot import JointMove
from ronna_hw.vectors import JointVector

ETHERNET_FILE = (
    Path(__file__).parents[2] / "drivers" / "kuka_rsi" / "controller" / "files" / "ronna_rsi_eth.xml"
)
SWING_RAD = 0.6
BARE_EXCHANGES = 1000
FAST_S, CYCLE_S = 0.001, 0.004
LOCK_STEP_GOAL, LOCK_STEP_GOAL_HZ = 0.40, 20_000.0  # of the bare exchange; the latter without load
FAST_ABOVE_ECHO_GOAL_US = 8.0  # at 1 ms, while the program is idle
ECHO, LINK_AT_REST, LINK_MOVING, RSIPI = "bare UDP echo", "driver at rest", "driver moving", "RSIPI"
BUSY_PARENT = "driver moving, its program busy"
UNREHEARSED = "driver moving, without rehearsal"


@dataclass(frozen=True)
class Size:
    """Numbers of rounds: lock-step moves, and telegram blocks at 1 ms and 4 ms, without and with CPU load."""

    lock_step: int = 20
    fast: int = 40
    at_cycle: int = 4
    loaded_lock_step: int = 8
    loaded_fast: int = 10
    loaded_at_cycle: int = 3
    block: int = 500  # telegrams


SMALLEST = Size(1, 1, 1, 1, 1, 1, block=20)


def measure(smallest: bool = False) -> list[Figure]:
    size = SMALLEST if smallest else Size()
    name, block = "lock-step cycles per second", size.block
    figures = _measure_lock_step(name, size.lock_step)
    ours = figures[0]
    figures.append(Figure(f"{name}, as such", ours.who, ours.value, ours.unit).at_least(LOCK_STEP_GOAL_HZ))
    figures += _measure_turnaround(
        "turnaround at 1 ms", FAST_S, size.fast, block, (LINK_AT_REST, LINK_MOVING, RSIPI)
    )
    at_cycle = (LINK_AT_REST, LINK_MOVING, UNREHEARSED, RSIPI)
    figures += _measure_turnaround("turnaround at 4 ms", CYCLE_S, size.at_cycle, block, at_cycle)
    with peer("image_load"):  # another process decodes images continuously
        figures += _measure_lock_step(f"{name} under an image load", size.loaded_lock_step)
        name = "turnaround at 1 ms under an image load"
        loaded = (LINK_AT_REST, LINK_MOVING, BUSY_PARENT)
        figures += _measure_turnaround(name, FAST_S, size.loaded_fast, block, loaded)
        name = "turnaround at 4 ms under an image load"
        figures += _measure_turnaround(name, CYCLE_S, size.loaded_at_cycle, block, loaded[1:])
    return figures


def _measure_lock_step(measure: str, rounds: int) -> list[Figure]:
    with RobotCell() as cell, peer("udp_echo") as echo:
        home = cell.arm.read_state().joints_rad
        away: JointVector = (home[0] + SWING_RAD, *home[1:])
        ends = [away, home]
        link = cell.arm.connections.link
        pids = {"simulator": cell.controller.process.pid, "driver's process": link.process.pid}
        spent = {name: 0.0 for name in pids}
        cycles_seen = 0
        whole_moves_hz: list[float] = []

        def move() -> float:
            nonlocal cycles_seen
            before = {name: process_cpu_s(pid) for name, pid in pids.items()}
            cycles, began = cell.arm.link_statistics().cycles, time.perf_counter()
            cell.arm.move(JointMove(ends[0]))
            ends.reverse()
            elapsed = time.perf_counter() - began
            cycles = cell.arm.link_statistics().cycles - cycles
            for name, pid in pids.items():
                spent[name] += process_cpu_s(pid) - before[name]
            cycles_seen += cycles
            whole_moves_hz.append(cycles / elapsed)
            return rate_in_motion(link.recorded_cycles())

        probe = ControllerProbe(echo.ready["endpoint"])

        def exchange() -> float:
            began = time.perf_counter()
            for _ in range(BARE_EXCHANGES):
                probe.exchange(bare_telegram())
            return BARE_EXCHANGES / (time.perf_counter() - began)

        baseline = "bare UDP exchange"
        samples = run_contest({"simulator and driver": move, baseline: exchange}, rounds)
        probe.close()
        figures = compare_samples(measure, "1/s", samples, baseline)
        figures[0] = figures[0].ratio_at_least(LOCK_STEP_GOAL)
        figures.append(Figure(f"{measure}, planning included", figures[0].who, median(whole_moves_hz), "1/s"))
        for name, cpu_s in spent.items():
            figures.append(Figure(f"CPU per cycle of {measure}", name, cpu_s / cycles_seen * 1e6, "µs"))
        return figures


def rate_in_motion(cycles: Sequence[RecordedCycle]) -> float:
    """Return the rate of cycles with a changed set-point, per second of host time; 0 without any."""
    gaps_ns = [
        later.received_ns - earlier.received_ns
        for earlier, later in pairwise(cycles)
        if later.cycle == earlier.cycle + 1 and later.sent_rad != earlier.sent_rad
    ]
    return len(gaps_ns) / sum(gaps_ns) * 1e9 if gaps_ns else 0.0


def _measure_turnaround(
    measure: str, pace_s: float, rounds: int, telegrams: int, contestants: tuple[str, ...]
) -> list[Figure]:
    """Alternate blocks of telegrams between the contestants and an echo server."""
    arguments = {
        ECHO: ("udp_echo",),
        LINK_AT_REST: ("rsi_link", "rest"),
        LINK_MOVING: ("rsi_link", "move"),
        BUSY_PARENT: ("rsi_link", "move", "busy"),
        UNREHEARSED: ("rsi_link", "move", "unrehearsed"),
        RSIPI: ("rsipi_client", str(ETHERNET_FILE)),
    }
    with ExitStack() as stack:
        peers = {name: stack.enter_context(peer(*arguments[name])) for name in (ECHO, *contestants)}
        probes = {
            name: stack.enter_context(ControllerProbe(child.ready["endpoint"]))
            for name, child in peers.items()
        }
        cpu_s = dict.fromkeys(peers, 0.0)

        def block(name: str) -> float:
            pid = peers[name].process.pid
            before_s = family_cpu_s(pid)
            found = median(probes[name].block(telegrams, pace_s))
            cpu_s[name] += family_cpu_s(pid) - before_s
            return found

        samples = run_contest({name: partial(block, name) for name in peers}, rounds)
        figures = compare_samples(measure, "µs", samples, ECHO, scale=1e6)
        sent = {name: len(probe.turnarounds_s) + probe.unanswered for name, probe in probes.items()}
        per_telegram = {name: [cpu_s[name] / sent[name]] for name in peers}
        share = {name: [cpu_s[name] / (sent[name] * pace_s)] for name in peers}
        figures = [_with_tail(figure, probes[figure.who]) for figure in figures]
        judged = [who for who in contestants if who not in (RSIPI, UNREHEARSED)]
        goals_us = dict.fromkeys(
            judged, FAST_ABOVE_ECHO_GOAL_US if pace_s == FAST_S else MEDIAN_ABOVE_ECHO_GOAL_US
        )
        goals_us |= dict.fromkeys({BUSY_PARENT} & {*judged}, MEDIAN_ABOVE_ECHO_GOAL_US)
        return [
            *figures,
            *compare_with_echo(measure, probes, ECHO, goals_us, cycle_s=CYCLE_S),
            *compare_samples(f"CPU per telegram, {measure}", "µs", per_telegram, ECHO, scale=1e6),
            *(
                Figure(f"share of one processor, {measure}", who, of[0] * 100.0, "%")
                for who, of in share.items()
            ),
        ]


def _with_tail(figure: Figure, probe: ControllerProbe) -> Figure:
    """Add the turnaround quantiles to the JSON output."""
    tail = {
        "median_us": probe.share(0.5) * 1e6,
        "p90_us": probe.share(0.9) * 1e6,
        "p99_us": probe.share(0.99) * 1e6,
        "telegrams": float(len(probe.turnarounds_s)),
        "moved_deg": probe.moved_deg,
    }
    return replace(figure, more=tail)
