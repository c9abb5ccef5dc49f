"""The UR driver arrives whichever answer its controller gives to what public sources leave open."""

from __future__ import annotations

from contextlib import ExitStack
from math import dist, radians

import pytest
from ur_clients import UrCell

from drivers.universal_robots import UniversalRobotsArm
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove, LineMove, StopKind
from ronna_hw.frames import Frame, Transform
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

PATIENT = {"silence_limit_s": 5.0, "heartbeat_limit_s": 10.0, "settle_tolerance_deg": 0.0008}
AWAY_RAD = radians(12.0)
LINE_MM = 25.0
AHEAD = Transform.of(Frame.FLANGE, Frame.FLANGE, translation_mm=(0.0, 0.0, LINE_MM))
# Rows of other answers than the best estimates: each row is a stranger controller.
ALTERNATIVES = [
    (ArmChoice.UR5E, "start=power_off", "booting_share=0.1", "script_start_s=0.3", "short_package=close"),
    (ArmChoice.UR5E, "start=idle", "robot_mode_bytes=46", "fieldbus_owns=lower"),
    (ArmChoice.UR5, "robot_mode_bytes=38", "state_period_s=0.3", "short_package=ignored"),
    (
        ArmChoice.UR5E,
        "drive_delay_cycles=3",
        "servoj_lag_s=0.02",
        "program_stop_rad_s2=5",
        "force_lag_s=0.05",
    ),
    (ArmChoice.UR5E, "factory_calibration=none", "reversal_deg=0.005", "stop_reaction_s=0.024"),
    (ArmChoice.UR5E, "factory_calibration=exact", "most_rtde_clients=3", "power_on_s=5", "brake_release_s=4"),
]
QUICK = 1  # rows that run by default
ROWS = [
    pytest.param(row, id=" ".join(map(str, row)), marks=() if number < QUICK else pytest.mark.slow)
    for number, row in enumerate(ALTERNATIVES)
]


@pytest.mark.parametrize("row", ROWS)
def test_the_arm_arrives_by_joint_and_by_linear_moves(row: tuple[str, ...]) -> None:
    model, *parameters = row
    with ExitStack() as stack:
        world = World.create(draw_scene("bench", seed=3, arm=ArmChoice(model)), paced=False)
        stack.callback(world.clock.close)
        settings = [f"--set={one}" for one in parameters]
        cell = UrCell(stack, "--world", world.endpoint, "--model", str(model), *settings, number=2)
        endpoints = {role: cell.endpoints[role] for role in ("rtde", "dashboard", "primary")}
        options = {**PATIENT, "model": str(model)}
        config = DeviceConfig(driver="universal_robots", endpoints=endpoints, options=options)
        arm = UniversalRobotsArm("robot.master", config, open_clock(world.clock_endpoint))
        stack.callback(arm.close)
        _work(arm, world)


def _work(arm: UniversalRobotsArm, world: World) -> None:
    arm.connect()
    arm.configure()
    for _ in range(2):  # the second run begins anew from where the arm stands
        arm.activate()
        kinematics = arm.kinematics
        start = arm.read_state().joints_rad
        arm.move(JointMove((start[0] + AWAY_RAD, *start[1:])))
        assert world.arm().joints_rad[0] - start[0] == pytest.approx(AWAY_RAD, abs=radians(0.01))
        begin = kinematics.flange_pose(arm.read_state().joints_rad)
        arm.move(LineMove(begin @ AHEAD))
        end = kinematics.flange_pose(arm.read_state().joints_rad)
        assert dist(end.translation_mm, begin.translation_mm) == pytest.approx(LINE_MM, abs=0.05)
        arm.stop(StopKind.HOLD)
        arm.resume()
        arm.move(LineMove(begin))
        arm.move(JointMove(start))
        assert arm.link_statistics().lost_cycles == 0
        arm.deactivate()
    assert arm.state is Lifecycle.CONFIGURED
