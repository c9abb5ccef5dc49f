from pathlib import Path

import numpy as np
import pytest

from ronna_hw.clock import CLOCK, open_clock
from sim.errors import WorldUnavailable
from sim.world.rigid import matrix_from, rotation_from_vector
from sim.world.scene.named_scenes import named_scene
from sim.world.world import ArmState, World


def test_another_process_sees_scene_arm_tool_step_and_faults() -> None:
    world = World.create(named_scene("mini", seed=5), paced=False)
    seen = World.open(world.endpoint)
    pose = matrix_from((1.0, 2.0, 3.0), rotation_from_vector((0.1, 0.2, 0.3)))
    world.publish_arm(ArmState((0.1, 0.2, 0.3, 0.4, 0.5, 0.6), pose, 7, True))
    world.mount_tool(2)
    world.clock.sleep(1.25)
    world.enter_step("at_target:T1")
    world.set_fault_script("at 1 s: robot drop 5 % for 1 s")
    assert seen.scene == world.scene
    assert seen.arm().joints_rad == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    assert np.array_equal(seen.arm().robot_from_flange, pose)
    assert (seen.arm().motion_number, seen.arm().at_rest) == (7, True)
    assert seen.mounted_tool() == 2
    assert seen.step() == ("at_target:T1", 1_250_000_000)
    assert seen.fault_script() == (1, "at 1 s: robot drop 5 % for 1 s")


def test_a_world_that_no_longer_exists_is_refused() -> None:
    with pytest.raises(WorldUnavailable, match="SIM-002"):
        World.open("shm:///proc/self/fd/9999")


def test_the_clock_is_in_its_own_memory_block_without_the_scene() -> None:
    world = World.create(named_scene("mini"), paced=False)
    assert world.clock_endpoint != world.endpoint
    assert Path(world.clock_endpoint.removeprefix("shm://")).stat().st_size == CLOCK.size_bytes
    world.clock.sleep(2.0)
    assert World.open(world.endpoint).clock.now_s() == open_clock(world.clock_endpoint).now_s() == 2.0
