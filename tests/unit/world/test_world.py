"""The shared world, the samples of its truth, and its noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from coded_errors import raises

from ronna_hw.clock import CLOCK, open_clock
from sim.errors import BAD_TRUTH, WORLD_UNAVAILABLE
from sim.world.noise import noise
from sim.world.rigid import matrix_from, rotation_from_vector
from sim.world.scene.named_scenes import draw_scene
from sim.world.truth import TRUTH_FILE, TipSample, TrueGuide, append_sample, read_samples, sample_instrument
from sim.world.world import ArmState, World


def test_another_process_sees_scene_arm_tool_step_and_faults() -> None:
    world = World.create(draw_scene("mini", seed=5), paced=False)
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
    with raises(WORLD_UNAVAILABLE, match="SIM-002"):
        World.open("shm:///proc/self/fd/9999")


def test_the_clock_is_in_its_own_memory_block_without_the_scene() -> None:
    world = World.create(draw_scene("mini"), paced=False)
    assert world.clock_endpoint != world.endpoint
    assert Path(world.clock_endpoint.removeprefix("shm://")).stat().st_size == CLOCK.size_bytes
    world.clock.sleep(2.0)
    assert World.open(world.endpoint).clock.now_s() == open_clock(world.clock_endpoint).now_s() == 2.0


def sampled() -> TipSample:
    world = World.create(draw_scene("mini"), paced=False)
    return sample_instrument(world, TrueGuide(world), "T1", 165.0, 0)


def test_samples_are_read_back_unchanged(tmp_path: Path) -> None:
    sample = sampled()
    append_sample(sample, tmp_path)
    assert read_samples(tmp_path) == [sample]


def test_every_bad_line_of_the_truth_is_reported(tmp_path: Path) -> None:
    append_sample(sampled(), tmp_path)
    with (tmp_path / TRUTH_FILE).open("a") as file:
        file.write('{"target": "T1"\nnonsense\n')
    with raises(BAD_TRUTH, match=r"SIM-007: .* invalid lines: line 2: .*line 3: "):
        read_samples(tmp_path)


def test_truth_that_is_not_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / TRUTH_FILE).write_bytes(b"\xff\xfe")
    with raises(BAD_TRUTH, match="not UTF-8 text"):
        read_samples(tmp_path)


def test_the_same_key_and_counter_always_give_the_same_numbers() -> None:
    assert np.array_equal(noise(7, "tracker", 12).normal(size=5), noise(7, "tracker", 12).normal(size=5))


def test_seed_device_counter_and_lane_each_change_the_numbers() -> None:
    keys = [
        (7, "tracker", 12, 0),
        (8, "tracker", 12, 0),
        (7, "arm", 12, 0),
        (7, "tracker", 13, 0),
        (7, "tracker", 12, 1),
    ]
    first = [noise(*key).normal() for key in keys]
    assert len(set(first)) == len(keys)


def test_the_numbers_of_many_counters_are_standard_normal() -> None:
    values = np.array([noise(1, "arm", counter).normal(size=3) for counter in range(2000)])
    assert abs(values.mean()) < 0.05
    assert abs(values.std() - 1.0) < 0.05
