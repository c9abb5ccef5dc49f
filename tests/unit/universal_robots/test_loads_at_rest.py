"""Loads of a Universal Robots arm: its signals summed at rest, cycle by cycle, and the load of its tool."""

from __future__ import annotations

from math import nan

import pytest
from coded_errors import raises
from rtde_stand import RtdeStand, streaming

from drivers.universal_robots.errors import BAD_LOAD
from drivers.universal_robots.loads import has_load, load_commands, to_load
from ronna_hw.arm_stream.load_sums import LoadMeans, mean_loads
from ronna_hw.arm_stream.records import LinkState
from ronna_hw.devices.contact import ToolLoad

CURRENTS_A, EXPECTED_A = (1.0, -2.0, 3.0, 0.5, 0.0, 0.0), (1.0, -2.5, 3.0, 0.0, 0.0, 0.0)
FORCE_N = (10.0, 0.0, -5.0)


def state(stand: RtdeStand) -> LinkState:
    return stand.session.state(real_time=False, locked=False)


def means(stand: RtdeStand, cycles: int) -> LoadMeans:
    before = state(stand)
    stand.cycles(cycles)
    return mean_loads(before, state(stand))


def test_the_means_of_a_standstill_are_those_of_its_packages() -> None:
    stand = streaming()
    stand.cycles(30)
    stand.currents_A, stand.expected_currents_A, stand.force_N = CURRENTS_A, EXPECTED_A, FORCE_N
    found = means(stand, 40)
    assert found.cycles == 40
    assert found.currents == pytest.approx(CURRENTS_A)
    assert found.expected_currents == pytest.approx(EXPECTED_A)
    assert found.force == pytest.approx(FORCE_N)


def test_nothing_is_summed_in_motion_and_a_new_standstill_begins_anew() -> None:
    stand = streaming()
    stand.cycles(30)
    before = state(stand)
    stand.move()
    stand.cycles(20)
    assert before.load_cycles > 0
    assert state(stand).load_cycles == 0
    stand.run()
    stand.cycles(30)
    assert 0 < state(stand).load_cycles <= 41
    assert state(stand).load_since > before.cycles


def test_a_cycle_whose_signals_are_no_numbers_does_not_count() -> None:
    stand = streaming()
    stand.cycles(30)
    before = state(stand)
    stand.currents_A = (nan,) * 6
    stand.cycles(10)
    assert state(stand).load_cycles == before.load_cycles
    stand.currents_A = CURRENTS_A
    assert means(stand, 10).currents == pytest.approx(CURRENTS_A)


def test_a_load_is_set_in_metres_and_compared_when_read_back() -> None:
    load = ToolLoad(1.2, (0.0, 1.0, 60.0), (0.0, 0.0, 150.0))
    assert load_commands(load) == ("set_payload(1.2, [0, 0.001, 0.06])", "set_tcp(p[0, 0, 0.15, 0, 0, 0])")
    read = to_load((1.2, 0.0, 0.001, 0.06, 0.0, 0.0, 0.15, 0.0, 0.0, 0.0))
    assert has_load(read, load, None)
    assert not has_load(ToolLoad(1.2, load.centre_mm), load, None)
    with raises(BAD_LOAD):
        load_commands(ToolLoad(5.5))
