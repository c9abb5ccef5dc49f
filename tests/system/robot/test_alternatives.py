"""Each driver arrives whichever answer its controller gives to a question that public sources leave open."""

from __future__ import annotations

from contextlib import ExitStack
from math import dist, radians

import pytest
from ur_clients import UrCell

from drivers.kuka_rsi import KukaRsiArm
from drivers.universal_robots import UniversalRobotsArm
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove, LineMove, StopKind
from ronna_hw.frames import Frame, Transform
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

PATIENT = {"silence_limit_s": 5.0, "heartbeat_limit_s": 10.0}  # these machines stall
AWAY_RAD = radians(12.0)
LINE_MM = 25.0
AHEAD = Transform.of(Frame.FLANGE, Frame.FLANGE, translation_mm=(0.0, 0.0, LINE_MM))
# Rows of other answers than the best estimates: each row is a stranger controller.
KUKA = [
    (4, "ipoc_start=4294967000", "ipoc_bits=64"),
    (12, "ipo_filter_s=0.03", "lag_s=0.03", "dead_time_cycles=3"),
    (4, "ipoc_start=4294967000", "delay_tells=in_a_row", "second_reply=taken", "missing_element=kept"),
    (4, "delay_tells=nothing", "stat_tells_limits=false"),
    (4, "delay_lag_cycles=1"),
    (4, "streams_from=movecorr", "movecorr_after_cycles=20"),
    (4, "corrections_act=rsi_on", "movecorr_after_cycles=50"),
    (4, "dead_time_cycles=3", "lag_s=0.03", "readout_step_deg=0.0005"),
    (4, "timeout_counting=total", "at_end_switch=clamp", "eki_loss_cancels=true", "inverted_status=7"),
]
UR = [
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


def rows(alternatives: list[tuple[object, ...]], quick: int) -> pytest.MarkDecorator:
    """The first of them run by default."""
    return pytest.mark.parametrize(
        "row",
        [
            pytest.param(row, id=" ".join(map(str, row)), marks=() if number < quick else pytest.mark.slow)
            for number, row in enumerate(alternatives)
        ],
    )


@rows(KUKA, quick=2)
def test_the_arm_of_a_kuka_arrives_by_joint_and_by_linear_moves(row: tuple[object, ...]) -> None:
    cycle_ms, *parameters = row
    with ExitStack() as stack:
        world = World.create(draw_scene("mini", seed=5), paced=False)
        stack.callback(world.clock.close)
        rsi, free = own_udp_endpoint(), "tcp://127.0.0.1:0"
        arguments = ["--rsi", rsi, "--eki", free, "--eki-project", free, "--world", world.endpoint]
        arguments += ["--cycle-ms", str(cycle_ms), *(f"--set={one}" for one in parameters)]
        child = stack.enter_context(ChildProcess("ronna-sim kuka", command("sim.cli", "kuka", *arguments)))
        endpoints = {"rsi": rsi, "eki_project": child.ready["endpoints"]["eki_project"]}
        options = {**PATIENT, "cycle_ms": cycle_ms}
        if "readout_step_deg=0.0005" in parameters:
            options["settle_tolerance_deg"] = 0.0005
        config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints, options=options)
        arm = KukaRsiArm("robot.master", config, open_clock(world.clock_endpoint))
        stack.callback(arm.close)
        _work(arm, world, near_rad=2e-5, near_mm=0.02)
        assert arm.link_statistics().late_cycles == 0


@rows(UR, quick=1)
def test_the_arm_of_universal_robots_arrives_by_joint_and_by_linear_moves(row: tuple[object, ...]) -> None:
    model, *parameters = row
    with ExitStack() as stack:
        world = World.create(draw_scene("bench", seed=3, arm=ArmChoice(model)), paced=False)
        stack.callback(world.clock.close)
        settings = [f"--set={one}" for one in parameters]
        cell = UrCell(stack, "--world", world.endpoint, "--model", str(model), *settings, number=2)
        endpoints = {role: cell.endpoints[role] for role in ("rtde", "dashboard", "primary")}
        options = {**PATIENT, "settle_tolerance_deg": 0.0008, "model": str(model)}
        config = DeviceConfig(driver="universal_robots", endpoints=endpoints, options=options)
        arm = UniversalRobotsArm("robot.master", config, open_clock(world.clock_endpoint))
        stack.callback(arm.close)
        _work(arm, world, near_rad=radians(0.01), near_mm=0.05)


def _work(arm: KukaRsiArm | UniversalRobotsArm, world: World, *, near_rad: float, near_mm: float) -> None:
    arm.connect()
    arm.configure()
    for _ in range(2):  # a second run begins with another time stamp, and anew from where the arm stands
        arm.activate()
        kinematics = arm.kinematics
        start = arm.read_state().joints_rad
        there = (start[0] + AWAY_RAD, *start[1:])
        arm.move(JointMove(there))
        assert world.arm().joints_rad == pytest.approx(there, abs=near_rad)
        begin = kinematics.flange_pose(arm.read_state().joints_rad)
        arm.move(LineMove(begin @ AHEAD))
        end = kinematics.flange_pose(world.arm().joints_rad)
        assert dist(end.translation_mm, begin.translation_mm) == pytest.approx(LINE_MM, abs=near_mm)
        arm.stop(StopKind.HOLD)
        arm.resume()
        arm.move(LineMove(begin))
        arm.move(JointMove(start))
        assert world.arm().joints_rad == pytest.approx(start, abs=near_rad)
        assert arm.link_statistics().lost_cycles == 0
        arm.deactivate()
    assert arm.state is Lifecycle.CONFIGURED
