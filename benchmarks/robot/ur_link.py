"""Stream of set-points to a Universal Robots controller, against bare exchanges and ur-rtde.

Lock-step: cycles per second through simulator and driver while the arm moves, by the driver's own record, on
joint moves and on straight lines with the factory calibration. Turnaround: package sent to set-point read, as
a controller sees it, in cycles of 2 ms (UR5e) and 8 ms (UR5), next to an echo and to a bare client of RTDE,
which unpacks and packs the same and decides nothing. Against ur-rtde the same relay in front of the simulator
measures each client in turn: ur-rtde needs a whole controller.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from statistics import median

from benchmarks.figures import Contestant, Figure, compare_samples, process_cpu_s, run_contest
from benchmarks.robot.robot_cell import peer
from benchmarks.robot.robot_link import rate_in_motion
from benchmarks.robot.turnaround import MEDIAN_ABOVE_ECHO_GOAL_US, compare_with_echo
from benchmarks.robot.ur_cell import CYCLE_S, ControllerStandIn, UrCell
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.robot import JointMove, LineMove
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

SWING_RAD = 0.6
LINE_MM = 100.0
BARE_EXCHANGES = 1000
LOCK_STEP_GOAL_HZ = 5_000.0
RTDE_SHARE_GOAL = 0.5
ECHO, BARE_RTDE, AT_REST, MOVING, UNREHEARSED = (
    "bare TCP echo",
    "bare client of RTDE",
    "driver at rest",
    "driver moving",
    "driver moving, without rehearsal",
)
JOINT_MOVE, LINE, BARE = "joint move", "straight line, calibrated", "bare TCP exchange"
BARE_RTDE_EXCHANGE = "bare RTDE exchange"
OURS, PLAIN = "driver", "driver, without priority"
POLLED, PACED = "ur-rtde servoJ, on each new state", "ur-rtde servoJ, by its own clock"
SETTLING_S = 1.0
STREAM_TRIES = 3  # a stall of the computer ends a stream, as it must
CB3_CYCLE_S = 0.008


@dataclass(frozen=True)
class Size:
    """Numbers of rounds, and of packages in a block."""

    lock_step: int = 10
    turnaround: int = 20
    block: int = 500
    cb3_turnaround: int = 10
    cb3_block: int = 125
    relayed: int = 3
    relayed_s: float = 4.0


SMALLEST = Size(1, 1, 20, 1, 20, 1, 0.5)


def measure(smallest: bool = False) -> list[Figure]:
    size = SMALLEST if smallest else Size()
    fast = (ECHO, BARE_RTDE, AT_REST, MOVING, UNREHEARSED)
    return [
        *_measure_lock_step(size),
        *_measure_turnaround("UR: turnaround at 2 ms", CYCLE_S, fast, size.turnaround, size.block),
        *_measure_turnaround(
            "UR: turnaround at 8 ms", CB3_CYCLE_S, fast[:-1], size.cb3_turnaround, size.cb3_block
        ),
        *_measure_beside_ur_rtde(size),
    ]


def _measure_lock_step(size: Size) -> list[Figure]:
    name = "UR: lock-step cycles per second"
    with UrCell() as cell, ExitStack() as stack:
        echo, bare_rtde = (stack.enter_context(ControllerStandIn()) for _ in range(2))
        stack.enter_context(peer("tcp_echo", echo.endpoint))
        stack.enter_context(peer("bare_rtde", bare_rtde.endpoint))
        cell.start()
        arm, link = cell.arm, cell.arm.connections.link
        home = arm.read_state().commanded_rad
        assert home is not None
        away: JointVector = (home[0] + SWING_RAD, *home[1:])
        ends = [away, home]
        line_ends = [_beside(arm.kinematics.forward(home), LINE_MM), arm.kinematics.flange_pose(home)]
        pids = {"simulator": cell.controller.process.pid, "driver's process": link.process.pid}
        spent = dict.fromkeys(pids, 0.0)
        cycles = 0

        def joint_move() -> float:
            nonlocal cycles
            before, count = {name: process_cpu_s(pid) for name, pid in pids.items()}, link.state.cycles
            for end in ends:
                arm.move(JointMove(end))
            cycles += link.state.cycles - count
            for who, pid in pids.items():
                spent[who] += process_cpu_s(pid) - before[who]
            return rate_in_motion(link.recorded_cycles())

        def line() -> float:
            for end in line_ends:
                arm.move(LineMove(end))
            return rate_in_motion(link.recorded_cycles())

        def exchange(stand_in: ControllerStandIn) -> float:
            began = time.perf_counter()
            for _ in range(BARE_EXCHANGES):
                stand_in.exchange()
            return BARE_EXCHANGES / (time.perf_counter() - began)

        contestants: dict[str, Contestant] = {
            JOINT_MOVE: joint_move,
            LINE: line,
            BARE_RTDE_EXCHANGE: partial(exchange, bare_rtde),
            BARE: partial(exchange, echo),
        }
        samples = run_contest(contestants, size.lock_step)
        figures = compare_samples(name, "1/s", samples, BARE)
        return [
            figures[0].at_least(LOCK_STEP_GOAL_HZ),
            *figures[1:],
            *(
                Figure(f"CPU per cycle of {name}", who, cpu_s / cycles * 1e6, "µs")
                for who, cpu_s in spent.items()
            ),
        ]


def _beside(flange: Pose, by_mm: float) -> Transform:
    x, y, z = flange.position_mm
    return Pose((x, y + by_mm, z), flange.rotation).to_transform()


def _measure_turnaround(
    name: str, cycle_s: float, contestants: tuple[str, ...], rounds: int, packages: int
) -> list[Figure]:
    """Alternate blocks of packages between the driver's process and bare clients."""
    model = "ur5" if cycle_s == CB3_CYCLE_S else "ur5e"
    arguments = {
        ECHO: ("tcp_echo",),
        BARE_RTDE: ("bare_rtde",),
        AT_REST: ("ur_link", "rest", model),
        MOVING: ("ur_link", "move", model),
        UNREHEARSED: ("ur_link", "move", model, "unrehearsed"),
    }
    with ExitStack() as stack:
        controllers = {who: stack.enter_context(ControllerStandIn(cycle_s=cycle_s)) for who in contestants}
        for who in contestants:
            program, *more = arguments[who]
            stack.enter_context(peer(program, controllers[who].endpoint, *more))

        def block(who: str) -> float:
            return median(controllers[who].block(packages, cycle_s))

        samples = run_contest({who: partial(block, who) for who in contestants}, rounds)
        figures = [
            replace(figure, more=_tail(controllers[figure.who]))
            for figure in compare_samples(name, "µs", samples, ECHO, scale=1e6)
        ]
        goals_us = dict.fromkeys((AT_REST, MOVING), MEDIAN_ABOVE_ECHO_GOAL_US)
        return [*figures, *compare_with_echo(name, controllers, ECHO, goals_us)]


def _tail(controller: ControllerStandIn) -> dict[str, float]:
    return {
        "median_us": controller.share(0.5) * 1e6,
        "p99_us": controller.share(0.99) * 1e6,
        "packages": float(len(controller.turnarounds_s)),
        "moved_rad": controller.moved_rad,
    }


def _measure_beside_ur_rtde(size: Size) -> list[Figure]:
    """Measure one client after the other through the same relay in front of a controller in real time."""

    def relayed(who: str) -> float | None:
        priority = {"real_time_priority": 0} if who == PLAIN else {}
        with UrCell(lock_step=False, **priority) as cell, ExitStack() as stack:
            relay = cell.relay
            assert relay is not None
            if who in (OURS, PLAIN):
                cell.start()
            else:
                way = "polled" if who == POLLED else "paced"
                stack.enter_context(peer("ur_rtde_client", relay.address, way))
            time.sleep(SETTLING_S)
            relay.turnarounds_s.clear()
            time.sleep(size.relayed_s)
            return median(relay.turnarounds_s) if relay.turnarounds_s else None

    def measured(who: str) -> float:
        for _ in range(STREAM_TRIES):
            if (found_s := relayed(who)) is not None:
                return found_s
        raise RuntimeError(f"{who} has stopped sending set-points, {STREAM_TRIES} times")

    clients = {who: partial(measured, who) for who in (OURS, PLAIN, POLLED, PACED)}
    medians = run_contest(clients, size.relayed, warm_up=0)
    figures = compare_samples("UR: turnaround beside ur-rtde", "µs", medians, POLLED, scale=1e6)
    return [figures[0].ratio_at_most(RTDE_SHARE_GOAL), *figures[1:]]
