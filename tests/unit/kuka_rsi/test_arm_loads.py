"""Signals of the load that the KUKA driver passes on: means at rest, missing where no stream carries them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from driven_arm import THERE
from fake_controller import FakeController

from ronna_hw.devices.axis_loads import TellsLoads
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.robot import JointMove

CURRENTS = (1.5, -31.25, 12.0, 0.25, -4.5, 0.0)


def test_the_means_at_rest_are_those_of_the_cycles_after_the_call(
    controller: FakeController, active_arm: Any
) -> None:
    assert isinstance(active_arm, TellsLoads)
    active_arm.read_loads(cycles=20)  # of zeros
    controller.currents_percent = CURRENTS
    active_arm.read_loads(cycles=1)  # the telegram under way may have been older
    loads = active_arm.read_loads(cycles=50)
    assert loads.validity is Validity.OK
    assert loads.cycles >= 50
    assert loads.current_percent == pytest.approx(CURRENTS)
    assert (loads.current_A, loads.expected_current_A, loads.force_N) == (None, None, None)
    assert loads.joints_rad == active_arm.read_state().joints_rad


def test_loads_are_those_of_one_standstill(controller: FakeController, active_arm: Any) -> None:
    controller.currents_percent = CURRENTS
    active_arm.read_loads(cycles=20)
    with ThreadPoolExecutor(1) as pool:
        moving = pool.submit(active_arm.move, JointMove(THERE))
        loads = active_arm.read_loads(cycles=2000, timeout_s=60.0)
        moving.result()
    assert loads.cycles >= 2000
    assert loads.joints_rad == pytest.approx(THERE, abs=4e-6)


def test_a_controller_that_does_not_send_currents_is_missing_and_never_zero(
    controller: FakeController, active_arm: Any
) -> None:
    controller.currents_percent = None
    active_arm.move(JointMove(THERE))  # telegrams under way had them
    loads = active_arm.read_loads()
    assert loads.validity is Validity.MISSING
    assert (loads.cycles, loads.current_percent) == (0, None)
    assert active_arm.link_statistics().rejected_telegrams == 0


def test_loads_need_a_running_stream(make_arm: Any) -> None:
    arm = make_arm()
    arm.connect()
    with pytest.raises(WrongState):
        arm.read_loads()
