"""Scripted trips: the message each raises, how the run ends or is clamped, and what Stat reports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from shared_controller import on_a1

from ronna_hw.wire.kuka_eki import AckCode, RsiState
from sim.errors import BadFaultScript
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.pendant import TRIPS as MESSAGES
from sim.world.faults import FaultBoard, check_faults, parse_faults
from sim.world.faults.robot import TRIPS
from sim.world.scene.named_scenes import named_scene
from sim.world.world import World

NUMBERS = {
    "timeout": 29002,
    "rsi_bad": 29002,
    "monitor": 29000,
    "torque": 1073,
    "acceleration": 1074,
    "velocity": 1102,
    "overspeed": 421,
    "end_switch": ControllerParameters().end_switch_message,
    "singularity": 1102,
}
ON_ITS_PATH = {"timeout", "rsi_bad", "monitor", "end_switch"}  # the arm brakes with its drives on


def test_a_script_can_name_every_existing_message_and_no_other() -> None:
    assert set(TRIPS) == set(MESSAGES) == set(NUMBERS)
    with pytest.raises(BadFaultScript, match=r"expected trip timeout, .*, got tea"):
        check_faults(parse_faults("now: robot trip tea"), named_scene("mini"))


@pytest.mark.parametrize("name", TRIPS)
def test_a_trip_ends_the_run_in_a_braked_stop_with_its_message(bench: Any, name: str) -> None:
    controller = bench.controller
    bench.enter_movecorr()
    bench.ramp(on_a1(4.0), steps=100)
    before = controller.arm.axes_deg[0]
    controller.trip(name)
    assert controller.message.number == NUMBERS[name]
    assert (controller.run, controller.rsi_state) == (None, RsiState.FAULT)
    assert controller.drives_on is (name in ON_ITS_PATH)
    while controller.moving:
        controller.settle()
    assert before < controller.arm.axes_deg[0] < before + 1.0
    assert controller.start().code is AckCode.REFUSED
    assert controller.acknowledge().code is AckCode.OK


def test_a_trip_of_an_idle_controller_raises_no_message(make_bench: Callable[..., Any]) -> None:
    controller = make_bench(start=False).controller
    controller.trip("velocity")
    assert controller.message is None


def test_narrowed_limits_clamp_corrections_from_the_current_position_and_stat_shows_it(bench: Any) -> None:
    controller = bench.controller
    bench.enter_movecorr()
    bench.ramp(on_a1(4.0))
    bench.rest(on_a1(4.0))
    for _ in range(3):
        controller.narrow_corrections(0.5)  # a lasting fault says it in every cycle
    bench.ramp(on_a1(6.0), from_deg=on_a1(4.0))
    bench.rest(on_a1(6.0))
    assert controller.arm.axes_deg[0] == 4.5
    assert controller.run.correction_stats == (0b11, 0)
    bench.ramp(on_a1(4.2), from_deg=on_a1(6.0))
    bench.rest(on_a1(4.2))
    assert (controller.arm.axes_deg[0], controller.run.correction_stats) == (4.2, (0b1, 0))
    controller.narrow_corrections(None)
    bench.ramp(on_a1(6.0), from_deg=on_a1(4.2))
    bench.rest(on_a1(6.0))
    assert (controller.arm.axes_deg[0], controller.message) == (6.0, None)


def test_a_fault_set_for_a_cycle_begins_with_that_telegram_and_lasts_in_theatre_time() -> None:
    world = World.create(named_scene("mini"), paced=False)
    seen: list[tuple[bool, int]] = []
    board = FaultBoard(world, "robot", lambda: len(seen) + 1)
    world.set_fault_script("at cycle 3: robot drop 7 % for 0.007 s\nat cycle 4: robot collision")
    for _ in range(7):
        seen.append((bool(board.active("drop")), len(board.happened("collision"))))
        world.clock.sleep(0.004)
    assert seen == [(False, 0), (False, 0), (True, 0), (True, 1), (False, 0), (False, 0), (False, 0)]
    world.clock.close()
