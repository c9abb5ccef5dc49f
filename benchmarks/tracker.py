"""Tracker clients on the simulated unit with BX replies: our driver, ndicapi, scikit-surgerynditracker."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from benchmarks.figures import Figure, compare_samples, measure_rate, process_cpu_s, run_contest
from benchmarks.peers import tracker_clients
from benchmarks.peers.tracker_clients import MakeReader, Reader
from benchmarks.robot.robot_cell import peer
from ronna_hw.host.child_process import ChildProcess, command
from sim.polaris.unit.tool_definition import write_definition
from sim.world.process import load_scene
from sim.world.scene.model import Scene, TrackerTool
from sim.world.scene.named_scenes import robot_frame
from sim.world.world import World

ROUNDS = 10
BLOCK_S = 0.12


@dataclass(frozen=True)
class Stand:
    """A client with its requests and tracker unit. In an unpaced world, every request gets a new frame.

    Without a scene the unit is one that knows a single answer.
    """

    client: MakeReader
    endpoint: str
    scene: Scene | None
    roms: Sequence[Path] = ()
    paced: bool = True

    def unit(self, name: str) -> ChildProcess:
        if self.scene is None:
            return peer("canned_unit", self.endpoint)
        world = World.create(self.scene, paced=self.paced)
        arguments = command("sim.cli", "polaris", "--endpoint", self.endpoint, "--world", world.endpoint)
        return ChildProcess(f"ronna-sim polaris for {name}", arguments)


@dataclass(frozen=True)
class Rates:
    """Measured rates by stand, one sample per round. `unit_cpu_s` is CPU time per reading over all rounds."""

    per_second: dict[str, list[float]]
    client_cpu_s: dict[str, list[float]]
    unit_cpu_s: dict[str, float]


def measure_rates(stands: Mapping[str, Stand], rounds: int) -> Rates:
    """Measure each stand's readings per second, and the CPU time per reading of client and unit."""
    with ExitStack() as stack:
        readers: dict[str, Reader] = {}
        pids: dict[str, int] = {}
        for name, stand in stands.items():
            unit = stack.enter_context(stand.unit(name))
            readers[name] = stand.client(stack, unit.ready["endpoint"], stand.roms)
            pids[name] = unit.process.pid
        client_cpu_s: dict[str, list[float]] = {name: [] for name in stands}
        unit_s = dict.fromkeys(stands, 0.0)
        readings = dict.fromkeys(stands, 0.0)

        def block(name: str) -> float:
            before_s = process_cpu_s(pids[name])
            rate, cpu_s = measure_rate(readers[name], BLOCK_S)
            client_cpu_s[name].append(cpu_s)
            unit_s[name] += process_cpu_s(pids[name]) - before_s
            readings[name] += rate * BLOCK_S
            return rate

        per_second = run_contest({name: partial(block, name) for name in stands}, rounds)
        return Rates(per_second, client_cpu_s, {name: unit_s[name] / readings[name] for name in stands})


LINES = {"TCP": "tcp://127.0.0.1:0", "pty": "serial-pty"}
OURS, NDICAPI, SCIKIT = "driver", "ndicapi", "scikit-surgerynditracker"
SOCKET = "bare socket in Python"  # the most that any client in Python reaches
CLIENTS = {OURS: tracker_clients.driver, NDICAPI: tracker_clients.ndicapi, SCIKIT: tracker_clients.scikit}
UNIT, CANNED = "ronna-sim polaris", "one fixed reply"
FEW, MANY = "1 tool", "3 tools, 6 strays"
# Goals for the driver relative to the peers' rates, and for the unit in replies per second, by line and load.
DRIVER_GOALS = {"TCP": {SCIKIT: 1.0, NDICAPI: 1.0}, "pty": {SCIKIT: 1.0, NDICAPI: 1.0 / 3.0}}
UNIT_GOALS = {("TCP", FEW): 15e3, ("pty", FEW): 5e3, ("TCP", MANY): 8e3, ("pty", MANY): 3e3}
MORE_TOOLS_MM = {  # markers of planar tools, no segment alike within them or in the first tool
    "pointer": ((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (25.0, 100.0, 0.0), (-25.0, 135.0, 0.0)),
    "probe": ((0.0, 0.0, 0.0), (0.0, 95.0, 0.0), (59.0, 38.0, 0.0), (-46.0, 119.0, 0.0)),
}
MORE_STRAYS_MM = ((60.0, -350.0, -1450.0), (-60.0, 350.0, -1550.0), (10.0, 60.0, -1350.0))  # besides three


def measure(smallest: bool = False) -> list[Figure]:
    """Measure each client's maximum reading rate, then the unit's maximum reply rate."""
    rounds = 1 if smallest else ROUNDS
    with tempfile.TemporaryDirectory() as folder:
        roms = _write_definitions(Path(folder))
        figures: list[Figure] = []
        for line in LINES:
            figures += _compare_clients(line, roms[:1], rounds)
        for line in LINES:
            figures += _measure_unit(line, roms, rounds)
        return figures


def _compare_clients(line: str, roms: Sequence[Path], rounds: int) -> list[Figure]:
    """Compare the clients reading one tool from a unit paced by the host clock."""
    bench = load_scene("bench")
    clients = CLIENTS | ({SOCKET: tracker_clients.bare_socket} if line == "TCP" else {})
    stands = {name: Stand(client, LINES[line], bench, roms) for name, client in clients.items()}
    rates = measure_rates(stands, rounds)
    what = f"readings/s, {line}"
    figures = [replace(figure, what=what) for figure in _compare_with_peers(line, rates)]
    figures += compare_samples(f"CPU/reading, {line}", "µs", rates.client_cpu_s, NDICAPI, scale=1e6)
    return figures


def _compare_with_peers(line: str, rates: Rates) -> list[Figure]:
    """Compare all clients with ndicapi, and our driver with each peer for which it has a goal."""
    rows = compare_samples("", "1/s", rates.per_second, NDICAPI)
    others = [row for row in rows if row.who != OURS]
    ours = []
    for rival, share in DRIVER_GOALS[line].items():
        pair = {name: rates.per_second[name] for name in (OURS, rival)}
        ours.append(compare_samples("", "1/s", pair, rival)[0].ratio_at_least(share))
    return [*ours, *others]


def _measure_unit(line: str, roms: Sequence[Path], rounds: int) -> list[Figure]:
    """Measure the unit's reply rate to ndicapi, both with repeated frames and with new ones.

    Compared with the minimum for a unit written in Python: one that knows a single answer.
    """
    bench = load_scene("bench")
    strays = (*bench.tracker.strays_mm, *MORE_STRAYS_MM)
    crowded = bench.model_copy(update={"tracker": bench.tracker.model_copy(update={"strays_mm": strays})})
    few = Stand(tracker_clients.ndicapi_replies, LINES[line], bench, roms[:1])
    many = replace(few, scene=crowded, roms=roms)
    rates = measure_rates(
        {
            FEW: few,
            MANY: many,
            f"{FEW}, all new": replace(few, paced=False),
            f"{MANY}, all new": replace(many, paced=False),
            CANNED: Stand(tracker_clients.ndicapi_bare, LINES[line], scene=None),
        },
        rounds,
    )
    figures = []
    for figure in compare_samples("", "1/s", rates.per_second, CANNED):
        goal = UNIT_GOALS.get((line, figure.who))
        figures.append(figure if goal is None else figure.at_least(goal))
    cpu_s = {load: [spent] for load, spent in rates.unit_cpu_s.items()}
    return [
        *(_label_unit_figure(figure, f"replies/s, {line}") for figure in figures),
        *(
            _label_unit_figure(figure, f"CPU/reply, {line}")
            for figure in compare_samples("", "µs", cpu_s, CANNED, scale=1e6)
        ),
    ]


def _label_unit_figure(figure: Figure, what: str) -> Figure:
    """Move the load from the client's name into the name of the measured quantity."""
    if figure.who == CANNED:
        return replace(figure, what=what)
    return replace(figure, what=f"{what}, {figure.who}", who=UNIT)


def _write_definitions(folder: Path) -> list[Path]:
    more = (TrackerTool(name=name, part_number=name, markers_mm=mm) for name, mm in MORE_TOOLS_MM.items())
    files = []
    for tool in (robot_frame(), *more):
        files.append(folder / f"{tool.name}.rom")
        files[-1].write_bytes(write_definition(tool))
    return files
