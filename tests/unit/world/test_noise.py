import numpy as np

from sim.world.noise import noise


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
