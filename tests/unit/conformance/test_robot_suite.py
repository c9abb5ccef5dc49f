"""The robot suite passes a good driver of an arm of another make and finds each mistake by its own case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from ideal_arm import Controller, IdealArm

from conformance import robot
from conformance.case import MOTION, CaseOutcome, SuiteCase
from conformance.device_under_test import DeviceUnderTest
from conformance.report import run_case
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.clock import Clock, HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import ArmReading, LinkStatistics, ToolIdentity, Validity
from ronna_hw.devices.robot import JointMove, LineMove, Motion, StopKind
from ronna_hw.preview import preview_motion
from ronna_hw.vectors import JointVector

MakeDut = Callable[..., DeviceUnderTest]


class FastClock(HostClock):
    """A clock on which a test waits little, but long enough for the arm's thread to go on."""

    def sleep(self, duration_s: float) -> None:
        super().sleep(duration_s / 10.0)


@pytest.fixture
def make_arm(make_dut: MakeDut) -> MakeDut:
    """The device under test for an ideal arm, some of whose members are replaced."""

    def make(**members: Any) -> DeviceUnderTest:
        driver = type("Spoilt", (IdealArm,), {"controller": Controller(), **members})
        dut = make_dut(driver, allowed=frozenset({MOTION.name}))
        dut.clock = FastClock()
        return dut

    return make


def test_a_good_arm_with_an_offset_wrist_passes_every_case(make_arm: MakeDut) -> None:
    dut = make_arm()
    assert {case.number: run_case(case, dut).reason for case in robot.SUITE.cases} == {
        case.number: "" for case in robot.SUITE.cases
    }


def shifted(joints_rad: JointVector, by_rad: float = 0.01) -> JointVector:
    first, *others = joints_rad
    return (first + by_rad, *others)


def nothing(self: IdealArm, *arguments: Any) -> None:
    return None


def spoilt_reading(change: Callable[[ArmReading], ArmReading]) -> Callable[..., ArmReading]:
    def read_state(self: IdealArm, timeout_s: float = 1.0) -> ArmReading:
        return change(IdealArm.read_state(self))

    return read_state


def other_motion(change: Callable[[Motion], Motion]) -> Callable[..., ArmReading]:
    def move(self: IdealArm, motion: Motion, *, timeout_s: float = 60.0) -> ArmReading:
        return IdealArm.move(self, change(motion))

    return move


def not_quite(motion: Motion) -> Motion:
    return replace(motion, target_rad=shifted(motion.target_rad)) if isinstance(motion, JointMove) else motion


def twice_as_far(motion: Motion) -> Motion:
    if isinstance(motion, JointMove):
        return motion
    return replace(motion, target=motion.target.displace((0.0, 0.0, robot.SMALL_LINE_MM)))


def without_tool(motion: Motion) -> Motion:
    if isinstance(motion, JointMove) or motion.flange_from_tool is None:
        return motion
    return LineMove(motion.target @ motion.flange_from_tool.inverse(), None, motion.speed_fraction)


def at_any_speed(motion: Motion) -> Motion:
    return replace(motion, speed_fraction=1.0)


def anywhere(self: IdealArm, motion: Motion, *, timeout_s: float = 60.0) -> ArmReading:
    self.guard.require("move", {Lifecycle.ACTIVE})
    if isinstance(motion, JointMove):
        self.controller.joints_rad = motion.target_rad
    return self.read_state()


def jumps(self: IdealArm, timeout_s: float = 10.0) -> None:
    IdealArm.activate(self)
    self.controller.joints_rad = shifted(self.controller.joints_rad)


def jumps_at_the_second(self: IdealArm, timeout_s: float = 10.0) -> None:
    IdealArm.deactivate(self)
    self.controller.joints_rad = shifted(self.controller.joints_rad)


def finds_another(self: IdealArm, timeout_s: float = 10.0) -> Identity:
    self.controller.cycles += 1
    return replace(IdealArm.connect(self), serial=str(self.controller.cycles))


def moves_on(self: IdealArm) -> None:
    IdealArm.resume(self)
    self.controller.joints_rad = shifted(self.controller.joints_rad)


def only_holds(self: IdealArm, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
    IdealArm.stop(self)


def takes_any_option(self: IdealArm, name: str, config: DeviceConfig, clock: Clock) -> None:
    IdealArm.__init__(self, name, config.model_copy(update={"options": {}}), clock)


def lets_it_go_on(self: IdealArm, timeout_s: float = 10.0) -> None:
    self.guard.enter(Lifecycle.CONFIGURED)


def beyond_the_margin(self: Any, motion: Motion, *, start_rad: JointVector) -> PathPreview:
    limits = replace(self.limits(), range_margin_rad=0.0)
    return preview_motion(self.kinematics, start_rad, motion, self.surroundings, limits)


def states_zeros(self: IdealArm, cycles: int = 1, timeout_s: float = 2.0) -> AxisLoads:
    return replace(IdealArm.read_loads(self, 0), validity=Validity.MISSING, current_A=(0.0,) * 6)


MISTAKES: dict[str, dict[str, Any]] = {
    "R01": {"surround": None},
    "R02": {"connect": lambda self, timeout_s=1.0: replace(IdealArm.connect(self), model="")},
    "R03": {"configure": nothing},
    "R04": {"read_state": spoilt_reading(lambda one: replace(one, commanded_rad=one.joints_rad))},
    "R05": {"read_tool_identity": lambda self, timeout_s=1.0: ToolIdentity(self._stamp(), -1)},
    "R06": {"activate": jumps},
    "R07": {"read_state": spoilt_reading(lambda one: replace(one, stamp=replace(one.stamp, sequence=7)))},
    "R08": {"link_statistics": lambda self: LinkStatistics(0, 0, 0, 0, 1.0, 2.0, (0.0, 1.0), (1,))},
    "R09": {"move": other_motion(at_any_speed)},
    "R10": {"deactivate": jumps_at_the_second},
    "R11": {"move": other_motion(not_quite)},
    "R12": {"move": other_motion(twice_as_far)},
    "R13": {"move": anywhere},
    "R14": {"resume": moves_on},
    "R15": {"stop": only_holds},
    "R16": {"close": nothing},
    "R17": {"connect": finds_another},
    "R18": {"connect": lambda self, timeout_s=1.0: self.guard.enter(Lifecycle.CONNECTED)},
    "R19": {"__init__": takes_any_option},
    "R20": {"move": anywhere},
    "R21": {"move": other_motion(without_tool)},
    "R26": {"deactivate": lets_it_go_on},
    "R27": {"limits": lambda self, mode=None: working_limits(universal_robot("ur5"))},
    "R28": {"preview": beyond_the_margin},
    "R29": {"insert": nothing, "senses_force": False},
    "R30": {"read_loads": states_zeros},
}


def case_of(number: str) -> SuiteCase:
    return next(case for case in robot.SUITE.cases if case.number == number)


@pytest.mark.parametrize("number", MISTAKES)
def test_each_mistake_is_found_by_its_case(make_arm: MakeDut, number: str) -> None:
    assert run_case(case_of(number), make_arm(**MISTAKES[number])).outcome is CaseOutcome.FAIL


def test_a_clock_that_stands_still_while_cycles_come_is_a_mistake(make_arm: MakeDut) -> None:
    stands_still = spoilt_reading(lambda one: replace(one, stamp=replace(one.stamp, device_clock=7)))
    result = run_case(case_of("R07"), make_arm(read_state=stands_still))
    assert result.outcome is CaseOutcome.FAIL
    assert "a cycle has come since" in result.reason


def test_a_late_host_is_no_mistake_of_the_clock(make_arm: MakeDut, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot, "LATE_PERIODS", 2)
    late = LinkStatistics(12, 4, 3, 0, 1.0, 2.0, (0.0, 1.0), (12,))
    result = run_case(case_of("R07"), make_arm(link_statistics=lambda self: late))
    assert result.outcome is CaseOutcome.SKIP
    assert "4 late, 3 lost cycles" in result.reason


def test_every_robot_case_has_its_mistake() -> None:
    """R22 to R25 are those of any device; the tracker's suite finds mistakes by them."""
    of_any_device = {f"R{number}" for number in range(22, 26)}
    assert MISTAKES.keys() == {case.number for case in robot.SUITE.cases} - of_any_device
