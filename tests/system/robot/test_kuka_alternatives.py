"""The driver arrives whichever answer the controller gives to a question that public sources leave open."""

from __future__ import annotations

from math import dist, radians

import pytest

from drivers.kuka_rsi import KukaRsiArm
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove, LineMove
from ronna_hw.frames import Frame, Transform
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

GENEROUS_S = 5.0  # these machines stall
AWAY_RAD = radians(12.0)
LINE_MM = 25.0
AHEAD = Transform.of(Frame.FLANGE, Frame.FLANGE, translation_mm=(0.0, 0.0, LINE_MM))
# Rows of other answers than the best estimates: each row is a stranger controller.
ALTERNATIVES = [
    ("ipoc_start=4294967000", "ipoc_bits=64"),
    ("ipoc_start=4294967000", "delay_tells=in_a_row", "second_reply=taken", "missing_element=kept"),
    ("delay_tells=nothing", "stat_tells_limits=false"),
    ("delay_lag_cycles=1",),
    ("streams_from=movecorr", "movecorr_after_cycles=20"),
    ("corrections_act=rsi_on", "movecorr_after_cycles=50"),
    ("dead_time_cycles=3", "lag_s=0.03", "readout_step_deg=0.0005"),
    ("timeout_counting=total", "at_end_switch=clamp", "eki_loss_cancels=true", "inverted_status=7"),
]
ALL_AT_12_MS = ("ipo_filter_s=0.03", "lag_s=0.03", "dead_time_cycles=3")
QUICK = 1  # rows that run by default


ROWS = [
    *(
        pytest.param(4, row, id=" ".join(row), marks=() if number < QUICK else pytest.mark.slow)
        for number, row in enumerate(ALTERNATIVES)
    ),
    pytest.param(12, ALL_AT_12_MS, id="12 ms " + " ".join(ALL_AT_12_MS)),
]


@pytest.mark.parametrize(("cycle_ms", "parameters"), ROWS)
def test_the_arm_arrives_by_joint_and_by_linear_moves(cycle_ms: int, parameters: tuple[str, ...]) -> None:
    world = World.create(draw_scene("mini", seed=5), paced=False)
    rsi, free = own_udp_endpoint(), "tcp://127.0.0.1:0"
    arguments = ["--rsi", rsi, "--eki", free, "--eki-project", free, "--world", world.endpoint]
    arguments += ["--cycle-ms", str(cycle_ms), *(f"--set={one}" for one in parameters)]
    with ChildProcess("ronna-sim kuka", command("sim.cli", "kuka", *arguments)) as child:
        endpoints = {"rsi": rsi, "eki_project": child.ready["endpoints"]["eki_project"]}
        options = {"silence_limit_s": GENEROUS_S, "heartbeat_limit_s": GENEROUS_S, "cycle_ms": cycle_ms}
        if "readout_step_deg=0.0005" in parameters:
            options["settle_tolerance_deg"] = 0.0005
        config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints, options=options)
        arm = KukaRsiArm("robot.master", config, open_clock(world.clock_endpoint))
        try:
            _work(arm, world)
        finally:
            arm.close()
    world.clock.close()


def _work(arm: KukaRsiArm, world: World) -> None:
    kinematics = arm.kinematics
    arm.connect()
    arm.configure()
    for _ in range(2):  # a second run begins with another time stamp, and anew from where the arm stands
        arm.activate()
        start = arm.read_state().joints_rad
        there = (start[0] + AWAY_RAD, *start[1:])
        arm.move(JointMove(there))
        assert world.arm().joints_rad == pytest.approx(there, abs=2e-5)
        begin = kinematics.flange_pose(arm.read_state().joints_rad)
        arm.move(LineMove(begin @ AHEAD))
        end = kinematics.flange_pose(world.arm().joints_rad)
        gone_mm = dist(end.translation_mm, begin.translation_mm)
        assert gone_mm == pytest.approx(LINE_MM, abs=0.02)
        arm.move(LineMove(begin))
        arm.move(JointMove(start))
        assert world.arm().joints_rad == pytest.approx(start, abs=2e-5)
        statistics = arm.link_statistics()
        assert (statistics.lost_cycles, statistics.late_cycles) == (0, 0)
        arm.deactivate()
    assert arm.state is Lifecycle.CONFIGURED
