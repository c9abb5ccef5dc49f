"""Clients of the tracker, each on its own simulated unit, alternately reading as fast as they can."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.contest import contest, process_cpu_s, rate_of
from benchmarks.peers.tracker_clients import MakeReader, Reader
from benchmarks.robot.robot_cell import peer
from ronna_hw.host.child_process import ChildProcess, command
from sim.world.scene.model import Scene
from sim.world.world import World

ROUNDS = 10
BLOCK_S = 0.12


@dataclass(frozen=True)
class Stand:
    """Which client requests what from which unit. In an unpaced world every request gets a frame of its own.

    Without a scene the unit is one that knows a single answer.
    """

    client: MakeReader
    endpoint: str
    scene: Scene | None
    roms: Sequence[Path] = ()
    paced: bool = True

    def unit(self, name: str) -> ChildProcess:
        """Its unit, started."""
        if self.scene is None:
            return peer("canned_unit", self.endpoint)
        world = World.create(self.scene, paced=self.paced)
        arguments = command("sim.cli", "polaris", "--endpoint", self.endpoint, "--world", world.endpoint)
        return ChildProcess(f"ronna-sim polaris for {name}", arguments)


@dataclass(frozen=True)
class Rates:
    """Samples by stand, one per round; `unit_cpu_s` is over all rounds together."""

    per_second: dict[str, list[float]]
    client_cpu_s: dict[str, list[float]]
    unit_cpu_s: dict[str, float]


def rates_of(stands: Mapping[str, Stand]) -> Rates:
    """Readings per second of each stand, and the CPU time per reading on either side."""
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
            rate, cpu_s = rate_of(readers[name], BLOCK_S)
            client_cpu_s[name].append(cpu_s)
            unit_s[name] += process_cpu_s(pids[name]) - before_s
            readings[name] += rate * BLOCK_S
            return rate

        per_second = contest({name: partial(block, name) for name in stands}, ROUNDS)
        return Rates(per_second, client_cpu_s, {name: unit_s[name] / readings[name] for name in stands})
