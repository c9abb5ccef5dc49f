"""Fault scripts act on interlocks, arm and EKI channels for as long as they specify, without sockets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from ronna_hw.wire.kuka_eki import OperationMode
from sim.kuka.faults import ControllerFaults
from sim.kuka.rsi.link import LinkFaults
from sim.world.faults import FaultBoard
from sim.world.faults.log import FaultLog
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

# What is true while a fault lasts, of the controller and of a channel.
LASTING: list[tuple[str, Callable[[Any, Any], bool]]] = [
    ("emergency stop", lambda c, _: c.interlocks.emergency_stop),
    ("guard open", lambda c, _: c.interlocks.guard_open),
    ("mode T1", lambda c, _: c.interlocks.mode is OperationMode.T1),
    ("start key held", lambda c, _: c.interlocks.start_key),
    ("enabling switch released", lambda c, _: not c.interlocks.enabling_switch),
    ("stick axis 2", lambda c, _: set(c.arm.drives._slipping) == {1}),
    ("clamp 0.5 deg", lambda c, _: c.run.flow._axis._within_deg == 0.5),
    ("eki silence", lambda _, channel: channel.silent),
    ("eki taken", lambda _, channel: channel.occupied),
]
MOMENTARY: list[tuple[str, Callable[[Any], bool]]] = [
    ("drives off", lambda c: not c.drives_on),
    ("collision", lambda c: c.message.number == c.parameters.collision_message),
    ("trip torque", lambda c: c.message.number == 1073),
    ("program restart", lambda c: c.runs == 2),
]


@pytest.fixture
def world() -> Iterator[World]:
    world = World.create(draw_scene("mini"), paced=False)
    yield world
    world.clock.close()


@pytest.fixture
def channel() -> SimpleNamespace:
    return SimpleNamespace(silent=False, occupied=False)


@pytest.fixture
def faults(bench: Any, world: World, channel: Any) -> ControllerFaults:
    log = FaultLog(lambda: (0.0, "no RSI"))
    board = FaultBoard(world, "robot", lambda: 1)
    return ControllerFaults(board, bench.controller, (channel,), LinkFaults(1, log.hit), log)


@pytest.mark.parametrize(("fault", "acts"), LASTING, ids=[fault for fault, _ in LASTING])
def test_a_lasting_fault_acts_until_it_ends(
    world: World, faults: ControllerFaults, bench: Any, channel: Any, fault: str, acts: Callable[..., bool]
) -> None:
    bench.enter_movecorr()
    for script, expected in (("", False), (f"now: robot {fault}", True), ("", False)):
        world.set_fault_script(script)
        faults.poll()
        assert acts(bench.controller, channel) is expected


@pytest.mark.parametrize(("fault", "happened"), MOMENTARY, ids=[fault for fault, _ in MOMENTARY])
def test_a_one_time_fault_has_happened_by_the_next_cycle(
    world: World, faults: ControllerFaults, bench: Any, fault: str, happened: Callable[[Any], bool]
) -> None:
    bench.enter_movecorr()
    world.set_fault_script(f"now: robot {fault}")
    faults.poll()
    assert happened(bench.controller)
