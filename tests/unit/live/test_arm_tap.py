"""Tap of an arm: each cycle once, with its theatre time, and poses at their rate."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from ideal_arm import Controller, IdealArm

from procedures.live.arm_tap import POSES_PER_S, ArmTap
from procedures.live.log_entries import JointCycles
from procedures.live.records import FramePose
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import StreamCycles
from ronna_hw.roles import MASTER

HOME_RAD = IdealArm.kinematics.home_rad
CYCLE_S = 0.004


@dataclass
class _Clock:
    """Theatre clock that is set by hand."""

    paced: bool
    at_s: float = 10.0

    def now_s(self) -> float:
        return self.at_s


@dataclass
class _Supervised:
    role: str = MASTER
    calibrated: CalibratedArm = field(default_factory=lambda: CalibratedArm(IdealArm.kinematics))


class _StreamingArm(IdealArm):
    """Keeps cycles as a streamed arm does."""

    controller = Controller(HOME_RAD)
    kept: StreamCycles | None = None

    def cycles_since(self, after_ns: int) -> StreamCycles | None:
        if self.kept is None:
            return None
        fresh = self.kept.received_ns > after_ns
        return StreamCycles._make(part[fresh] for part in self.kept)

    def keep(self, count: int, *, first: int, newest_ns: int) -> None:
        numbers = np.arange(first, first + count)
        received_ns = newest_ns - ((first + count - 1 - numbers) * CYCLE_S * 1e9).astype(np.int64)
        joints_rad = np.tile(HOME_RAD, (count, 1)) + 1e-6 * numbers[:, None]
        self.kept = StreamCycles(received_ns, (4 * numbers).astype(np.uint64), joints_rad, joints_rad + 0.1)


@pytest.fixture
def arm() -> _StreamingArm:
    arm = _StreamingArm("robot.master", DeviceConfig(driver="ideal", endpoint="host:"), HostClock())
    arm.connect()
    return arm


def _tap(arm: IdealArm, clock: _Clock) -> ArmTap:
    supervised: Any = _Supervised()
    clock_of_it: Any = clock
    return ArmTap(supervised, arm, clock.now_s, clock_of_it)


def _cycles(entries: list[Any]) -> JointCycles:
    (cycles,) = [one for one in entries if isinstance(one, JointCycles)]
    return cycles


def test_each_cycle_comes_once_with_the_time_at_which_its_telegram_came(arm: _StreamingArm) -> None:
    clock = _Clock(paced=True)
    tap = _tap(arm, clock)
    now_ns = time.monotonic_ns()
    arm.keep(25, first=1, newest_ns=now_ns + 10**9)  # after the tap was made
    tap._seen_ns = 0
    entries = tap.look()
    cycles = _cycles(entries)
    assert np.diff(cycles.times_s) == pytest.approx([CYCLE_S] * 24)
    assert cycles.measured_rad[0].tolist() == pytest.approx(np.array(HOME_RAD) + 1e-6)
    assert cycles.commanded_rad is not None
    assert cycles.commanded_rad[0] == pytest.approx(cycles.measured_rad[0] + 0.1)
    poses = [one for one in entries if isinstance(one, FramePose)]
    assert len(poses) == pytest.approx(25 * CYCLE_S * POSES_PER_S, abs=1.0)
    pose = IdealArm.kinematics.forward(tuple(cycles.measured_rad[-1]))
    assert tap.latest_pose is not None
    assert tap.latest_pose.translation_mm == pytest.approx(pose.position_mm)
    assert tap.latest_pose.rotation is not None
    assert abs(np.dot(tap.latest_pose.rotation, pose.quaternion())) == pytest.approx(1.0)
    assert (tap.latest_pose.parent, tap.latest_pose.child) == ("robot", "flange")
    assert tap.look() == []


def test_in_lock_step_cycles_follow_the_clock_of_the_controller(arm: _StreamingArm) -> None:
    clock = _Clock(paced=False)
    tap = _tap(arm, clock)
    now_ns = time.monotonic_ns() + 10**9
    arm.keep(10, first=1, newest_ns=now_ns)
    assert _cycles(tap.look()).times_s.tolist() == [10.0]  # from here on they are known
    clock.at_s = 10.4
    arm.keep(100, first=11, newest_ns=now_ns + 10**6 + 100 * 10**7)
    times_s = _cycles(tap.look()).times_s
    assert times_s[-1] == pytest.approx(10.4)
    assert np.diff(times_s, prepend=10.0) == pytest.approx([CYCLE_S] * 100)


def test_an_arm_that_does_not_stream_shows_its_last_reading_once(arm: _StreamingArm) -> None:
    tap = _tap(arm, _Clock(paced=False))
    assert tap.look() == []
    arm.read_state()
    tap._observed_at_s = 0.0  # it is time to look again
    assert _cycles(tap.look()).measured_rad.tolist() == [list(HOME_RAD)]
    tap._observed_at_s = 0.0
    assert tap.look() == []
