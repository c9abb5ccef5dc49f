"""A person leans on the guide, through the wire: world, controller, real-time process, driver, estimate."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from math import radians
from typing import Any

import numpy as np
import pytest

from drivers.kuka_rsi import KukaRsiArm
from drivers.universal_robots import UniversalRobotsArm
from procedures.calibration.guide_load import LoadEstimate, Standstill, estimate_load
from procedures.steps.clinical.guide_load import as_standstill
from ronna_hw.arm.catalogue import ArmChoice, find_arm
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.robot import JointMove
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_address, own_udp_endpoint
from ronna_hw.vectors import Vector3, joint_vector
from ronna_hw.wire.kuka_context import OWN_CONTEXT
from sim.world.scene.named_scenes import draw_scene
from sim.world.tool_load import SimulatedLoad
from sim.world.world import World

PATIENT = {"silence_limit_s": 5.0, "heartbeat_limit_s": 5.0}  # these machines stall
PUSH_N = (60.0, 0.0, 0.0)
PUSH = "at 0 s: room push guide 60 0 0 N"
AWAY_RAD = radians(8.0)
REFERENCES = 4


def kuka_of(world: World, started: ExitStack) -> KukaRsiArm:
    rsi, free = own_udp_endpoint(), "tcp://127.0.0.1:0"
    arguments = ["--rsi", rsi, "--eki", free, "--eki-project", free, "--world", world.endpoint]
    arguments += ["--rsi-context", str(OWN_CONTEXT)]
    child = started.enter_context(ChildProcess("kuka", command("sim.cli", "kuka", *arguments)))
    endpoints = {"rsi": rsi, "eki_project": child.ready["endpoints"]["eki_project"]}
    config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints, options=PATIENT)
    return KukaRsiArm("robot.master", config, open_clock(world.clock_endpoint))


def ur_of(world: World, started: ExitStack) -> UniversalRobotsArm:
    arguments = ("--address", own_address(), "--model", "ur5e", "--world", world.endpoint)
    child = started.enter_context(ChildProcess("ur", command("sim.cli", "ur", *arguments)))
    endpoints = {role: child.ready["endpoints"][role] for role in ("rtde", "dashboard", "primary")}
    config = DeviceConfig(
        driver="universal_robots", endpoints=endpoints, options={**PATIENT, "model": "ur5e"}
    )
    return UniversalRobotsArm("robot.master", config, open_clock(world.clock_endpoint))


@contextmanager
def active(choice: ArmChoice, make: Callable[[World, ExitStack], Any]) -> Iterator[tuple[World, Any]]:
    world = World.create(draw_scene("mini", seed=6, arm=choice), paced=False)
    with ExitStack() as started:
        arm = make(world, started)
        started.callback(arm.close)
        arm.connect()
        arm.configure()
        arm.activate()
        yield world, arm
    world.clock.close()


class Room:
    """Standstills of an arm with the guide, and the estimate against those that nobody touched."""

    def __init__(self, world: World, arm: Any) -> None:
        self._world, self._arm = world, arm
        self._guide_mm: Vector3 = SimulatedLoad(world).point_mm
        world.mount_tool(world.scene.mount.tool_number_guide)
        self.home = arm.read_state().joints_rad
        self.references = [self.stop_at(number) for number in range(1, REFERENCES + 1)]
        arm.move(JointMove(self.home))

    def stop_at(self, number: int) -> Standstill:
        ways = np.random.default_rng(number).uniform(-1.0, 1.0, 6)
        self._arm.move(JointMove(joint_vector(np.array(self.home) + AWAY_RAD * ways)))
        return self.standstill()

    def standstill(self) -> Standstill:
        found = as_standstill(self._arm.read_loads(), find_arm(self._arm.kinematics.name).load, "guide")
        assert found is not None
        return found

    def estimate(self) -> LoadEstimate:
        arm = self._arm.kinematics
        now = self.standstill()
        return estimate_load(arm, find_arm(arm.name).load, self.references, now, self._guide_mm)


@pytest.mark.parametrize(
    ("choice", "make", "off_N"),
    [
        pytest.param(ArmChoice.KR6, kuka_of, 60.0, id="kr6"),
        pytest.param(ArmChoice.UR5E, ur_of, 12.0, id="ur5e"),
    ],
)
def test_a_person_who_leans_on_the_guide_is_seen_and_one_who_lets_go_is_not(
    choice: ArmChoice, make: Callable[[World, ExitStack], Any], off_N: float
) -> None:
    with active(choice, make) as (world, arm):
        room = Room(world, arm)
        assert not room.estimate().is_loaded
        before = arm.read_state().joints_rad
        world.set_fault_script(PUSH)
        pushed = room.estimate()
        assert arm.read_state().joints_rad == before  # encoders show nothing
        assert pushed.is_loaded
        assert np.linalg.norm(pushed.force_N - PUSH_N) < off_N
        error_N = pushed.force_N - PUSH_N
        assert error_N @ np.linalg.solve(pushed.covariance_N2, error_N) < 16.3
        stiffness_N_mm = world.scene.arm.stiffness_N_mm
        sizes_mm = np.sqrt(np.diag(pushed.displacement_covariance_mm2))
        assert np.all(np.abs(pushed.displacement_mm - np.array(PUSH_N) / stiffness_N_mm) < 4.0 * sizes_mm)
        world.set_fault_script("")
        assert not room.estimate().is_loaded


def test_each_reading_is_of_cycles_of_its_own() -> None:
    with active(ArmChoice.KR6, kuka_of) as (_, arm):
        one, two = (arm.read_loads(cycles=30) for _ in range(2))
        assert isinstance(one, AxisLoads)
        assert isinstance(two, AxisLoads)
        assert one.validity is two.validity is Validity.OK
        assert one.current_percent is not None
        assert two.stamp.device_clock - one.stamp.device_clock >= 30 * 4  # IPOC, ms
        assert two.stamp.theatre_time_s > one.stamp.theatre_time_s
