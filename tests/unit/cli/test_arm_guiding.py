"""An arm that is led by hand: the key that is a switch, and arms that follow no hand."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import pytest
from coded_errors import raises
from ideal_arm import Controller, IdealArm

from procedures.cli.arm.guiding import HELD_S, HeldKey
from procedures.workcell.hand_guiding import lead_by_hand
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import FORCE_NOT_SENSED
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.contact import GuidanceEnd, Guided, HandGuidance
from ronna_hw.devices.lifecycle import Lifecycle


class Keyboard:
    """A keyboard with a clock of its own."""

    def __init__(self) -> None:
        self.read_end, self._write_end = os.pipe()
        self.now_s = 0.0
        self.key = HeldKey(self.read_end, lambda: self.now_s)

    def type(self, keys: bytes) -> None:
        os.write(self._write_end, keys)

    def close(self) -> None:
        os.close(self.read_end)
        os.close(self._write_end)


@pytest.fixture
def keyboard() -> Iterator[Keyboard]:
    keyboard = Keyboard()
    yield keyboard
    keyboard.close()


@pytest.mark.hazard(57)
def test_the_key_is_a_switch_only_while_it_repeats(keyboard: Keyboard) -> None:
    assert not keyboard.key.is_held()
    keyboard.type(b"  ")
    assert keyboard.key.is_held()
    keyboard.now_s += 0.9 * HELD_S
    assert keyboard.key.is_held()
    keyboard.now_s += 0.2 * HELD_S
    assert not keyboard.key.is_held()
    keyboard.type(b" q")
    assert not keyboard.key.is_held()
    assert keyboard.key.is_over


class RestingArm(IdealArm):
    """An assistant that senses no force."""

    def __init__(self) -> None:
        super().__init__("robot.assistant", DeviceConfig(driver="ideal", endpoint="host:"), HostClock())
        self.controller = Controller(IdealArm.kinematics.home_rad)


class FollowingArm(RestingArm):
    """Follows a hand as long as the switch is held."""

    def __init__(self) -> None:
        super().__init__()
        self.guidances: list[HandGuidance] = []

    def guide_by_hand(self, guidance: HandGuidance, is_held: Callable[[], bool]) -> Guided:
        self.guidances.append(guidance)
        while is_held():
            pass
        return Guided(self.read_state(), GuidanceEnd.RELEASED)


@pytest.mark.hazard(57)
def test_an_arm_follows_while_the_switch_is_held_and_rests_afterwards() -> None:
    arm, held = FollowingArm(), iter([False, True, True, False, False, True, False, False])
    ended: list[bool] = []

    def is_held() -> bool:
        now = next(held, None)
        if now is None:
            ended.append(True)
        return bool(now)

    last = lead_by_hand(arm, HandGuidance(reach_mm=80.0), Surroundings(), is_held, lambda: bool(ended))
    assert [one.reach_mm for one in arm.guidances] == [80.0, 80.0]
    assert last is not None
    assert last.end is GuidanceEnd.RELEASED
    assert arm.state is not Lifecycle.ACTIVE
    arm.close()


def test_an_arm_that_senses_no_force_follows_no_hand() -> None:
    arm = RestingArm()
    with raises(FORCE_NOT_SENSED, match="ARM-013"):
        lead_by_hand(arm, HandGuidance(), Surroundings(), lambda: True, lambda: False)
    arm.close()
