"""Motor currents of the simulated controller: weight, a hand on the guide, friction and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.drives import Drives
from sim.kuka.motor_currents import LARGEST_TORQUES_NM, MotorCurrents
from sim.world.descriptions import DESCRIPTIONS
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

QUIET = ControllerParameters(current_noise_percent=1e-9, current_error_share=1e-9)
PUSH = "at 0 s: room push guide 0 60 0 N"


@pytest.fixture(scope="module")
def world() -> World:
    return World.create(draw_scene("default", seed=4), paced=False)


def currents_of(world: World, parameters: ControllerParameters = QUIET) -> MotorCurrents:
    arm = world.scene.arm
    drives = Drives(DESCRIPTIONS[arm.variant], arm.home_deg, parameters)
    return MotorCurrents(world, drives, parameters)


def test_the_first_axis_of_an_arm_that_nobody_touches_holds_only_friction(world: World) -> None:
    share_percent = 100.0 * QUIET.stiction_share
    assert abs(currents_of(world).at(0)[0]) <= share_percent + 0.1


def test_a_hand_on_the_guide_shows_by_what_exceeds_the_stiction(world: World) -> None:
    currents = currents_of(world, replace(QUIET, stiction_share=1e-9))
    sticky = currents_of(world)
    free, before = currents.at(0), sticky.at(0)
    world.set_fault_script(PUSH)
    try:
        change = np.subtract(currents.at(3), free)
        seen = np.subtract(sticky.at(3), before)
    finally:
        world.set_fault_script("")
    lever_m = change[0] / 100.0 * LARGEST_TORQUES_NM[0] / 60.0
    assert 0.5 < lever_m < 1.0  # the guide is ahead of A1, which points down
    assert abs(change[0]) - abs(seen[0]) <= 2.0 * 100.0 * QUIET.stiction_share
    assert currents.at(6) == pytest.approx(free, abs=1e-5)


def test_the_weight_of_the_mounted_tool_shows(world: World) -> None:
    currents = currents_of(world, replace(QUIET, stiction_share=1e-9))
    world.mount_tool(0)
    bare = currents.at(0)[1]
    world.mount_tool(world.scene.mount.tool_number_guide)
    assert currents.at(3)[1] - bare < -1.0  # percent; A2 turns the arm down


def test_the_same_cycle_of_the_same_seed_has_the_same_currents(world: World) -> None:
    plain = ControllerParameters()
    first, second = currents_of(world, plain), currents_of(world, plain)
    steps = [first.at(cycle) for cycle in range(12)]
    assert second.at(9) == pytest.approx(steps[9])
    assert steps[0] == steps[2] != steps[3]  # a new value every third cycle
