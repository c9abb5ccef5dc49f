"""Power and safety of the arm, in cycles."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from ronna_hw.wire.universal_robots import RobotMode, SafetyMode, SafetyStatus
from sim.universal_robots.controller import Controller

MakeController = Callable[..., Controller]


def run_s(controller: Controller, duration_s: float) -> None:
    for _ in range(round(duration_s / controller.model.cycle_s)):
        controller.step()


def test_power_comes_in_steps_and_only_a_brake_release_lets_the_arm_move(make: MakeController) -> None:
    controller = make("start=power_off")
    modes = controller.modes
    modes.power_on()
    seen = [modes.robot_mode]
    for _ in range(2000):
        controller.step()
        if modes.robot_mode is not seen[-1]:
            seen.append(modes.robot_mode)
    assert seen == [RobotMode.BOOTING, RobotMode.POWER_ON, RobotMode.IDLE]
    assert not modes.may_move
    modes.release_brakes()
    run_s(controller, 1.5)
    assert modes.may_move


def test_a_brake_release_powers_on_too(make: MakeController) -> None:
    controller = make("start=power_off")
    controller.modes.release_brakes()
    run_s(controller, 3.6)
    assert controller.modes.robot_mode is RobotMode.RUNNING


def test_a_protective_stop_can_be_unlocked_after_five_seconds(controller: Controller) -> None:
    controller.protective_stop("test")
    run_s(controller, 4.9)
    assert not controller.unlock_protective_stop()
    run_s(controller, 0.2)
    assert controller.modes.safety_bits == (
        SafetyStatus.PROTECTIVE_STOPPED | SafetyStatus.STOPPED_DUE_TO_SAFETY
    )
    assert controller.unlock_protective_stop()
    assert controller.modes.may_move


@pytest.mark.parametrize(
    "pressed", [SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP], ids=lambda one: one.name
)
def test_an_emergency_stop_takes_the_power_and_releasing_it_does_not_give_it_back(
    controller: Controller, pressed: SafetyMode
) -> None:
    controller.hold(pressed)
    run_s(controller, 0.6)
    assert controller.modes.robot_mode is RobotMode.POWER_OFF
    controller.modes.power_on()
    assert controller.modes.robot_mode is RobotMode.POWER_OFF
    controller.hold(pressed, holds=False)
    assert controller.modes.safety_mode is SafetyMode.NORMAL
    assert controller.modes.robot_mode is RobotMode.POWER_OFF


@pytest.mark.parametrize("broken", [SafetyMode.VIOLATION, SafetyMode.FAULT], ids=lambda one: one.name)
def test_after_a_violation_or_fault_only_a_restart_of_safety_helps(
    controller: Controller, broken: SafetyMode
) -> None:
    controller.hold(broken)
    run_s(controller, 6.0)
    controller.unlock_protective_stop()
    assert controller.modes.safety_mode is broken
    controller.modes.restart_safety()
    run_s(controller, 2.1)
    assert controller.modes.safety_mode is SafetyMode.NORMAL
    assert controller.modes.robot_mode is RobotMode.POWER_OFF


def test_of_several_stops_the_gravest_is_shown(controller: Controller) -> None:
    for mode in (SafetyMode.SAFEGUARD_STOP, SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.PROTECTIVE_STOP):
        controller.hold(mode)
    assert controller.modes.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP
