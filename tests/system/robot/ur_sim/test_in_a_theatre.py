"""The controller in the world of a theatre: its clock, its true arm, its faults and the mounted tool."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from math import radians

import numpy as np
import pytest
from ur_clients import RUN, UrCell, stream

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.wire.universal_robots import TOOL_INPUTS, SafetyMode
from sim.errors import BadFaultScript
from sim.world.faults import check_faults, parse_faults
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm
from sim.world.world import World

STEP_RAD, STEPS = 0.0004, 100
SCENE = draw_scene("bench", seed=2, arm=ArmChoice.UR5E)


@pytest.fixture(scope="module")
def world() -> World:
    return World.create(SCENE, paced=False)


@pytest.fixture(scope="module")
def theatre_cell(world: World) -> Iterator[UrCell]:
    with ExitStack() as stack:
        yield UrCell(stack, "--world", world.endpoint, number=0)


def test_the_arm_begins_at_home_where_the_true_arm_is(world: World, theatre_cell: UrCell) -> None:
    assert theatre_cell.child.ready["model"] == "ur5e"
    state = world.arm()
    assert state.at_rest
    assert state.joints_rad == pytest.approx([radians(angle) for angle in SCENE.arm.home_deg])
    expected = TrueArm(SCENE.arm, SCENE.seed).at_rest(state.joints_rad, state.flanks, 0)
    np.testing.assert_allclose(state.robot_from_flange, expected)


def test_a_streamed_motion_is_seen_in_the_world_at_its_own_time(world: World, theatre_cell: UrCell) -> None:
    client, home = stream(theatre_cell)
    began_s, began, number = world.clock.now_s(), client.state(), 1
    goal = [home[0] + STEPS * STEP_RAD, *home[1:]]
    while world.arm().motion_number == 0 or not world.arm().at_rest:
        number += 1
        client.put(number, 0, RUN, [home[0] + min(number, STEPS) * STEP_RAD, *home[1:]])
        state = client.state()
    moved_s = state.timestamp_s - began.timestamp_s
    assert world.clock.now_s() - began_s == pytest.approx(moved_s, abs=3 * 0.002)
    arm = world.arm()
    assert arm.joints_rad == pytest.approx(goal)
    expected = TrueArm(SCENE.arm, SCENE.seed).at_rest(arm.joints_rad, arm.flanks, 1, arm.moved_s)
    np.testing.assert_allclose(arm.robot_from_flange, expected)

    def answer() -> None:
        nonlocal number
        while waiter.is_alive():
            number += 1
            client.put(number, 0, RUN, goal)
            client.state()

    waiter = threading.Thread(target=world.clock.sleep, args=(1.0,))  # a resting arm lets others wait
    rested_s = world.clock.now_s()
    waiter.start()
    answer()
    waiter.join()
    assert world.clock.now_s() - rested_s == pytest.approx(1.0, abs=0.2)
    assert world.arm().motion_number == 1
    client.socket.close()


def test_a_fault_of_the_rooms_script_reaches_the_controller(world: World, theatre_cell: UrCell) -> None:
    client = theatre_cell.rtde()
    client.set_up()
    world.set_fault_script("now: ur safeguard open")
    while client.state().safety_mode != SafetyMode.SAFEGUARD_STOP:
        pass
    world.set_fault_script("")
    while client.state().safety_mode != SafetyMode.NORMAL:
        pass
    client.socket.close()


def test_the_mounted_tool_is_on_the_inputs(world: World, theatre_cell: UrCell) -> None:
    client = theatre_cell.rtde()
    assert client.ask("O", struct.pack(">d", 500.0) + b"actual_digital_input_bits")[0]
    assert client.ask("S") == b"\1"
    for number in (2, 0, 1):
        world.mount_tool(number)
        while struct.unpack(">Q", client.next("U")[1:])[0] >> TOOL_INPUTS.start != number:
            pass


def test_a_theatre_has_the_faults_of_its_own_arm() -> None:
    check_faults(parse_faults("now: ur frozen"), SCENE)
    with pytest.raises(BadFaultScript, match="expected a fault of the tracker, ur, camera or room"):
        check_faults(parse_faults("now: robot drop 5 %"), SCENE)
    with pytest.raises(BadFaultScript, match="tracker, robot, camera or room"):
        check_faults(parse_faults("now: ur frozen"), draw_scene("bench"))
