"""The driver for Universal Robots and the simulated controller, each in processes of their own.

In lock-step a control cycle begins once the client has answered, however slow this machine is.
"""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from math import radians
from typing import Any

import pytest
from coded_errors import raises
from handmade_ur import HandmadeController
from ur_clients import OUTPUTS, UrCell
from waiting import eventually

from drivers.universal_robots import UniversalRobotsArm
from drivers.universal_robots.errors import (
    CONTROLLER_STOPPED,
    LINK_BROKEN,
    LOAD_NOT_TAKEN,
    PROGRAM_STOPPED,
    PROTECTIVE_STOP,
    SCRIPT_NOT_STARTED,
    STREAM_ERRORS,
    SWITCHED_TO_LOCAL,
    RegistersInUse,
)
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arm.errors import LOADED_AT_START, ForceLimitExceeded
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.contact import GuidanceEnd, HandGuidance, Insertion, ToolLoad
from ronna_hw.devices.robot import JointMove
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import ErrorCode, RonnaError, is_error
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

PATIENT = {"silence_limit_s": 5.0, "heartbeat_limit_s": 10.0, "settle_tolerance_deg": 0.0008}
ROLES = ("rtde", "dashboard", "primary")
TURN_RAD = radians(20.0)
SLOW = 0.1  # of the arm's speed: still under way when its stop arrives, at full speed of the host
BARE_FLANGE = Transform.of(Frame.FLANGE, Frame.TOOL)
FORCE_LIMIT_N = 15.0
# Tissue 1 mm ahead, thin skin, then bone, whose resistance rises by 40 N/mm.
SKIN_MM = 0.5
LIMIT_DEPTH_MM = 1.0 + SKIN_MM + FORCE_LIMIT_N / 40.0
GUIDED_MM = 10.0

MOVER = """
import sys, threading
from drivers.universal_robots import UniversalRobotsArm
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import JointMove

endpoints = dict(zip(("rtde", "dashboard", "primary"), sys.argv[1:]))
config = DeviceConfig(driver="universal_robots", endpoints=endpoints, options={"starve_limit_s": 0.1})
arm = UniversalRobotsArm("robot.master", config, HostClock())
arm.connect()
arm.configure()
arm.activate()
start = arm.read_state().commanded_rad
there = (start[0] + 1.0, *start[1:])
threading.Thread(target=arm.move, args=(JointMove(there),), daemon=True).start()
while not arm.read_state().joints_rad[0] > start[0] + 0.05:
    pass
print(arm.connections.open_link.process.pid, flush=True)
sys.stdin.read()
"""


class Room:
    """A controller in lock-step, in the world of a theatre whose faults are scripted."""

    def __init__(self, stack: ExitStack) -> None:
        scene = draw_scene("bench", seed=3, arm=ArmChoice.UR5E)
        self.world = World.create(scene, paced=False)
        settings = ("--set", "protective_stop_lock_s=0.1", "--set", f"skin_mm={SKIN_MM}")
        self.cell = UrCell(stack, "--world", self.world.endpoint, *settings, number=2)
        self.config = DeviceConfig(
            driver="universal_robots",
            endpoints={role: self.cell.endpoints[role] for role in ROLES},
            options=PATIENT,
        )
        self.clock = open_clock(self.world.clock_endpoint)

    def make_arm(self) -> UniversalRobotsArm:
        return UniversalRobotsArm("robot.master", self.config, self.clock)

    def await_cycles(self, condition: Callable[[], bool]) -> None:
        """Let the controller run until a condition holds; without a stream its time stands still."""

        def holds() -> bool:
            self.clock.sleep(0.01)
            return condition()

        eventually(holds)

    def inject(self, fault: str = "") -> None:
        """Let a fault act from now on, or none."""
        self.world.set_fault_script(f"at {self.world.clock.now_s():.6f} s: ur {fault}" if fault else "")


@pytest.fixture(scope="module")
def room() -> Iterator[Room]:
    with ExitStack() as stack:
        yield Room(stack)


@pytest.fixture
def arm(room: Room) -> Iterator[UniversalRobotsArm]:
    """An arm that streams."""
    room.inject()
    made = room.make_arm()
    made.connect()
    made.configure()
    made.activate()
    yield made
    made.close()


def turned(joints_rad: JointVector, by_rad: float = TURN_RAD) -> JointVector:
    return (joints_rad[0] + by_rad, *joints_rad[1:])


class Motion:
    """A motion in a thread of its own, under way."""

    def __init__(self, arm: UniversalRobotsArm) -> None:
        self.start: JointVector = arm.read_state().commanded_rad or arm.read_state().joints_rad
        self.errors: list[RonnaError] = []
        self._thread = threading.Thread(target=self._move, args=(arm,))
        self._thread.start()
        eventually(lambda: abs(self._measured(arm) - self.start[0]) > TURN_RAD / 10)

    def end(self) -> RonnaError:
        """Return the error that ended the motion."""
        self._thread.join()
        return self.errors[0]

    def _move(self, arm: UniversalRobotsArm) -> None:
        try:
            target_rad = turned(self.start, -TURN_RAD if self.start[0] > 0.0 else TURN_RAD)
            arm.move(JointMove(target_rad, speed_fraction=SLOW))
        except RonnaError as error:
            self.errors.append(error)

    @staticmethod
    def _measured(arm: UniversalRobotsArm) -> float:
        reading = arm.observe().reading
        assert reading is not None
        return reading.joints_rad[0]


@pytest.mark.parametrize(
    ("fault", "error", "says"),
    [
        pytest.param(
            "emergency stop pressed", CONTROLLER_STOPPED, "emergency stop", marks=pytest.mark.slow
        ),  # the arm is switched on again
        pytest.param("protective stop", PROTECTIVE_STOP, "protective stop", marks=pytest.mark.hazard(53)),
        pytest.param("program pause", PROGRAM_STOPPED, "stopped or paused", marks=pytest.mark.hazard(53)),
        ("cut rtde", LINK_BROKEN, ""),
        pytest.param("local mode", SWITCHED_TO_LOCAL, "local control", marks=pytest.mark.hazard(55)),
    ],
)
def test_a_stop_from_outside_is_latched_and_left_only_in_the_name_of_a_person(
    room: Room, arm: UniversalRobotsArm, fault: str, error: ErrorCode[RonnaError], says: str
) -> None:
    motion = Motion(arm)
    room.inject(fault)
    ended = motion.end()
    assert is_error(ended, error)
    assert says in str(ended)
    assert arm.state is Lifecycle.FAULT
    room.inject()
    room.await_cycles(lambda: room.cell.dashboard("is in remote control") == "true")
    room.await_cycles(lambda: room.world.arm().at_rest)
    if "emergency" in fault:  # it ends in POWER_OFF, also if the button is pulled out before
        room.await_cycles(lambda: "POWER_OFF" in room.cell.dashboard("robotmode"))
    rest = room.world.arm().joints_rad
    arm.recover("Ann", timeout_s=30.0)
    assert room.world.arm().joints_rad == pytest.approx(rest, abs=radians(0.001))
    arm.activate()
    arm.move(JointMove(motion.start))


def test_a_pendant_turned_to_remote_control_during_a_recovery_leaves_an_arm_that_starts(
    room: Room, arm: UniversalRobotsArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The switch closes once more the connection that `recover` has just reopened."""
    acknowledge = arm.connections.acknowledge

    def turned_meanwhile(person: str, deadline: float) -> None:
        room.inject()
        room.await_cycles(lambda: room.cell.dashboard("is in remote control") == "true")
        acknowledge(person, deadline)

    room.inject("local mode")
    eventually(lambda: arm.fault is not None)
    monkeypatch.setattr(arm.connections, "acknowledge", turned_meanwhile)
    arm.recover("Ann", timeout_s=30.0)
    arm.activate()


@pytest.mark.hazard(54)
def test_registers_that_another_client_owns_are_refused_until_it_has_gone(room: Room) -> None:
    other = room.cell.rtde()
    other.set_up()
    arm = room.make_arm()
    arm.connect()
    arm.configure()
    with pytest.raises(RegistersInUse):
        arm.activate()
    other.socket.close()
    arm.recover("Ann", timeout_s=30.0)
    arm.activate()
    arm.close()


def test_a_script_that_does_not_start_is_reported(room: Room) -> None:
    """The primary interface is another's, which takes no script."""
    deaf = HandmadeController(parse_endpoint(room.config.endpoints["primary"]).host)
    endpoints = {**room.config.endpoints, "primary": deaf.endpoints["primary"]}
    arm = UniversalRobotsArm("arm", room.config.model_copy(update={"endpoints": endpoints}), room.clock)
    arm.connect()
    arm.configure()
    with raises(SCRIPT_NOT_STARTED):
        arm.activate(timeout_s=0.5)
    arm.close()
    deaf.close()


@pytest.mark.slow
@pytest.mark.hazard(30)
@pytest.mark.timeout(180)
@pytest.mark.parametrize("victim", ["program", "real-time process"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_an_arm_whose_program_or_link_is_killed_or_frozen_comes_to_rest_on_its_way(
    victim: str, number: signal.Signals
) -> None:
    with ExitStack() as stack:
        cell = UrCell(stack, number=1)
        addresses = [cell.endpoints[role] for role in ROLES]
        mover: Any = subprocess.Popen(
            [sys.executable, "-c", MOVER, *addresses],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        link_pid = int(mover.stdout.readline())
        watcher = cell.rtde()
        watcher.ask("O", struct.pack(">d", 125.0) + OUTPUTS.encode())
        watcher.ask("S")
        os.kill(mover.pid if victim == "program" else link_pid, number)
        eventually(_is_at_rest(watcher), 10.0)
        assert 0.05 < watcher.state().target_rad[0] < 0.9
        eventually(lambda: cell.dashboard("running") == "Program running: false", 10.0)
        for pid in (mover.pid, link_pid):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        mover.communicate()


def _is_at_rest(watcher: Any) -> Callable[[], bool]:
    return lambda: all(abs(speed) < 1e-6 for speed in watcher.state().speed_rad_s)


@pytest.mark.slow
def test_a_real_time_process_that_dies_is_named(room: Room, arm: UniversalRobotsArm) -> None:
    motion = Motion(arm)
    arm.connections.link.process.kill()
    assert is_error(motion.end(), STREAM_ERRORS.died)
    arm.recover("Ann", timeout_s=30.0)
    arm.activate()


def inserted(arm: UniversalRobotsArm, depth_mm: float, limit_N: float | None = FORCE_LIMIT_N) -> Insertion:
    start = arm.read_state().commanded_rad
    assert start is not None
    way = Transform.of(Frame.TOOL, Frame.TOOL, translation_mm=(0.0, 0.0, depth_mm))
    return Insertion(
        arm.kinematics.flange_pose(start) @ BARE_FLANGE @ way, BARE_FLANGE, force_limit_N=limit_N
    )


class Inserting:
    """An insertion in a thread of its own, under way."""

    def __init__(self, arm: UniversalRobotsArm) -> None:
        self._arm, self._start = arm, arm.read_state().joints_rad
        self._errors: list[RonnaError] = []
        self._thread = threading.Thread(target=self._insert)
        self._thread.start()
        eventually(lambda: travelled_mm(arm, self._start) > 0.5)

    def end(self) -> RonnaError:
        """Return the error that ended the insertion."""
        self._thread.join()
        return self._errors[0]

    def rests_on_its_way(self, world: World) -> bool:
        """Return whether the true arm is at rest between start and depth."""
        arm = self._arm
        way = arm.kinematics.flange_pose(self._start).inverse() @ arm.kinematics.flange_pose(
            world.arm().joints_rad
        )
        return world.arm().at_rest and 0.5 < way.translation_mm[2] < 19.0

    def _insert(self) -> None:
        try:
            self._arm.insert(inserted(self._arm, 20.0))
        except RonnaError as error:
            self._errors.append(error)


@pytest.mark.slow
@pytest.mark.hazard(30)
def test_a_real_time_process_that_freezes_in_mid_insertion_leaves_the_instrument_at_rest_and_is_named(
    room: Room, arm: UniversalRobotsArm
) -> None:
    inserting = Inserting(arm)
    pid = arm.connections.link.process.pid
    os.kill(pid, signal.SIGSTOP)
    eventually(lambda: room.world.arm().at_rest)
    depth_rad = room.world.arm().joints_rad
    ended = inserting.end()
    os.kill(pid, signal.SIGKILL)
    assert ended.code == STREAM_ERRORS.stalled.code
    assert arm.state is Lifecycle.FAULT
    assert room.world.arm().joints_rad == depth_rad
    assert inserting.rests_on_its_way(room.world)


@pytest.mark.hazard(56)
def test_a_program_that_is_killed_in_mid_insertion_leaves_the_instrument_at_rest_and_is_named(
    room: Room, arm: UniversalRobotsArm
) -> None:
    inserting = Inserting(arm)
    assert room.cell.dashboard("stop") == "Stopped"
    assert is_error(inserting.end(), PROGRAM_STOPPED)
    assert arm.state is Lifecycle.FAULT
    room.await_cycles(lambda: room.world.arm().at_rest)
    assert inserting.rests_on_its_way(room.world)


def travelled_mm(arm: UniversalRobotsArm, start: JointVector) -> float:
    before, after = (arm.kinematics.flange_pose(q) for q in (start, arm.read_state().joints_rad))
    return float((before.inverse() @ after).translation_mm[2])


@pytest.mark.hazard(56)
def test_an_insertion_stops_in_bone_at_its_force_limit_and_ends_at_its_depth_without(
    room: Room, arm: UniversalRobotsArm
) -> None:
    start = arm.read_state().joints_rad
    room.inject("tissue 1 mm ahead")
    with pytest.raises(ForceLimitExceeded):
        arm.insert(inserted(arm, 10.0))
    assert arm.state is Lifecycle.HOLD
    beyond_mm = travelled_mm(arm, start) - LIMIT_DEPTH_MM
    assert -0.1 < beyond_mm < 0.7
    arm.resume()
    arm.insert(inserted(arm, -travelled_mm(arm, start), limit_N=None))
    room.inject()
    done = arm.insert(inserted(arm, 2.0))
    assert done.travel_mm == pytest.approx(2.0, abs=0.02)
    assert done.peak_force_N is not None
    assert done.peak_force_N < FORCE_LIMIT_N


@pytest.mark.hazard(56)
def test_a_load_is_read_back_and_one_that_the_controller_does_not_take_is_refused(
    room: Room, arm: UniversalRobotsArm
) -> None:
    load = ToolLoad(0.8, (0.0, 0.0, 40.0), (0.0, 0.0, 120.0))
    read = arm.set_tool_load(load)
    assert read.mass_kg == pytest.approx(load.mass_kg)
    assert read.centre_mm == pytest.approx(load.centre_mm)
    assert read.tip_mm == pytest.approx(load.tip_mm)
    room.inject("load kept")
    room.clock.sleep(0.02)  # the controller sees faults only in its next cycle
    with raises(LOAD_NOT_TAKEN):
        arm.set_tool_load(ToolLoad(1.0), timeout_s=1.0)
    room.inject()
    room.clock.sleep(0.02)
    arm.set_tool_load(ToolLoad(0.0))


@pytest.mark.hazard(57)
def test_a_hand_that_pushes_before_the_guidance_is_not_followed(room: Room, arm: UniversalRobotsArm) -> None:
    room.inject("hand +0 +0 +30 N")
    room.clock.sleep(0.5)
    with raises(LOADED_AT_START, match=r"\d N \(x .* in the frame of the base\)"):
        arm.guide_by_hand(HandGuidance(), lambda: True)
    assert arm.read_state().moving is False


@pytest.mark.hazard(57)
def test_the_arm_follows_a_hand_until_it_is_released(room: Room, arm: UniversalRobotsArm) -> None:
    def height_mm() -> float:
        return float(arm.kinematics.flange_pose(arm.read_state().joints_rad).translation_mm[2])

    begin_mm = height_mm()
    looks = 0

    def is_held() -> bool:
        nonlocal looks
        looks += 1
        if looks == 2:  # a hand that pushes at the start is refused
            room.inject("hand +0 +0 +30 N")
        return height_mm() < begin_mm + GUIDED_MM

    guided = arm.guide_by_hand(HandGuidance(), is_held)
    room.inject()
    assert guided.end is GuidanceEnd.RELEASED
    assert not guided.reading.moving
    assert arm.state is Lifecycle.ACTIVE
