"""Torques held by a true arm, and what its gears hide of them."""

from __future__ import annotations

import numpy as np
import pytest

from sim.world.descriptions import DESCRIPTIONS
from sim.world.held_torques import HeldTorques, Stiction
from sim.world.noise import TabledNoise

LIMITS_NM = (10.0, 20.0, 10.0, 2.0, 2.0, 1.0)
STRETCHED_RAD = (0.0,) * 6


def kr6() -> HeldTorques:
    return HeldTorques("kr6_r900_sixx", DESCRIPTIONS["kr6_r900_sixx"].links)


def test_a_load_at_the_flange_of_the_stretched_arm_turns_shoulder_and_elbow_by_its_lever() -> None:
    arm = kr6()
    bare_Nm = arm.weight_Nm(STRETCHED_RAD)
    arm.carry(2.0, (0.0, 0.0, 0.0))
    added_Nm = np.subtract(arm.weight_Nm(STRETCHED_RAD), bare_Nm)
    # A2 and A5 turn the arm down: the motor holds against that. Levers: 0.955, 0.5 and 0.08 m.
    assert added_Nm == pytest.approx(-9.81 * 2.0 * np.array([0.0, 0.955, 0.5, 0.0, 0.08, 0.0]), abs=1e-9)


def test_a_force_sideways_is_held_by_the_base_axis_against_the_push() -> None:
    # A1 points down: positive angles turn the arm to its right, -y.
    pushed_Nm = kr6().against_force_Nm(STRETCHED_RAD, (0.0, 60.0, 0.0), (0.0, 0.0, 0.0))
    assert pushed_Nm[0] == pytest.approx(60.0 * 0.98)


def test_a_load_within_the_stiction_does_not_show_and_a_larger_one_shows_by_the_excess() -> None:
    gears = Stiction(LIMITS_NM, seed=1)
    at_first = gears.at_rest((0.0,) * 6, stop=1)

    def held_Nm(load_Nm: float) -> float:
        return gears.at_rest((load_Nm, 0.0, 0.0, 0.0, 0.0, 0.0), stop=1)[0]

    upwards, downwards = held_Nm(at_first[0] + 15.0), held_Nm(at_first[0] - 9.0)
    assert upwards == pytest.approx(at_first[0] + 5.0)
    assert downwards == pytest.approx(at_first[0] + 1.0)


def test_where_the_friction_stays_is_a_function_of_seed_and_stop() -> None:
    stops = [Stiction(LIMITS_NM, seed=1).at_rest((0.0,) * 6, stop) for stop in (1, 2, 1)]
    assert stops[0] == stops[2] != stops[1]
    assert np.all(np.abs(stops[1]) <= LIMITS_NM)


def test_tabled_noise_is_a_function_of_seed_device_and_cycle() -> None:
    one, same, other = TabledNoise(3, "a"), TabledNoise(3, "a"), TabledNoise(3, "b")
    many = np.array([one.at(cycle, 6) for cycle in range(2000)])
    assert same.at(1234, 6) == list(many[1234])
    assert other.at(1234, 6) != list(many[1234])
    assert many.std() == pytest.approx(1.0, abs=0.05)
    assert np.abs(np.corrcoef(many.T) - np.eye(6)).max() < 0.1
