"""A simulated controller in its own world, connected to the arm driver, and bare UDP for comparison."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from drivers.kuka_rsi import KukaRsiArm
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from sim.world.process import load_scene
from sim.world.world import World

PEERS = Path(__file__).parents[1] / "peers"
SILENCE_LIMIT_S = 5.0  # lock-step waits up to 2 s for a reply


def peer(name: str, *arguments: str) -> ChildProcess:
    """Start one of the peers and wait until it is ready; its READY line states the port."""
    return ChildProcess(name, [sys.executable, "-P", str(PEERS / f"{name}.py"), *arguments])


class RobotCell:
    """`ronna-sim kuka` in lock-step, and an active arm."""

    def __init__(self) -> None:
        self._ending = ExitStack()
        self.world = World.create(load_scene("bench"), paced=False)
        free = "tcp://127.0.0.1:0"
        more = ["--world", self.world.endpoint, "--rsi", own_udp_endpoint()]
        arguments = command("sim.cli", "kuka", *more, "--eki", free, "--eki-project", free)
        self.controller = self._ending.enter_context(ChildProcess("ronna-sim kuka", arguments))
        ready = self.controller.ready["endpoints"]
        config = DeviceConfig(
            driver="kuka_rsi",
            endpoints={"rsi": ready["rsi"], "eki_project": ready["eki_project"]},
            options={"silence_limit_s": SILENCE_LIMIT_S},
        )
        self.arm = KukaRsiArm("robot.master", config, open_clock(self.world.clock_endpoint))
        self._ending.callback(self.arm.close)

    def __enter__(self) -> Self:
        try:
            self.arm.connect()
            self.arm.configure()
            self.arm.activate()
        except BaseException:  # including interruptions: no controller is left running
            self._ending.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.close()
