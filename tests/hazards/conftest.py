"""Small theatres for the hazard tests: one simulated device, its world, and the driver at the other end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clinical_case import ClinicalCell
from numpy.typing import NDArray
from rsi_tap import RsiTap

from drivers.kuka_rsi import KukaRsiArm
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from sim.world.process import load_scene
from sim.world.world import World

NEVER_S = 10**9  # theatre time


class RobotCell:
    """A simulated controller in a world of the test's own, which knows where the arm truly is."""

    def __init__(self, *options: str, paced: bool) -> None:
        self.world = World.create(load_scene("bench"), paced=paced)
        free = "tcp://127.0.0.1:0"
        self.controller = ChildProcess(
            "ronna-sim kuka",
            command(
                "sim.cli", "kuka", "--world", self.world.endpoint,
                "--rsi", own_udp_endpoint(),
                "--eki", free, "--eki-project", free, *options,
            ),
        )  # fmt: skip
        ready = self.controller.ready["endpoints"]
        self.endpoints = {"rsi": ready["rsi"], "eki_project": ready["eki_project"]}
        self.arms: list[KukaRsiArm] = []
        # A controller that reads its first script while the arm moves stands still for that long.
        self.world.set_fault_script(f"at {NEVER_S} s: robot drop 1 %")

    def arm(self, **options: Any) -> KukaRsiArm:
        """A driver for this controller, closed at the end of the test."""
        config = DeviceConfig(driver="kuka_rsi", endpoints=self.endpoints, options=options)
        self.arms.append(KukaRsiArm("robot.master", config, open_clock(self.world.clock_endpoint)))
        return self.arms[-1]

    def active_arm(self, **options: Any) -> KukaRsiArm:
        arm = self.arm(**options)
        arm.connect()
        arm.configure()
        arm.activate()
        return arm

    def true_joints_rad(self) -> NDArray[np.float64]:
        return np.array(self.world.arm().joints_rad)

    def close(self) -> None:
        for arm in self.arms:
            arm.close()
        self.controller.stop()


@pytest.fixture
def robot_cell() -> Iterator[Callable[..., RobotCell]]:
    """Makes robot cells; `paced` worlds run in real time, others in lock-step."""
    cells: list[RobotCell] = []

    def make(*options: str, paced: bool = False) -> RobotCell:
        cells.append(RobotCell(*options, paced=paced))
        return cells[-1]

    yield make
    for cell in cells:
        cell.close()


@pytest.fixture
def tapped_cell(robot_cell: Any) -> Iterator[Callable[..., tuple[Any, RsiTap]]]:
    """Makes a robot cell with somebody on its wire."""
    made: list[tuple[Any, RsiTap]] = []

    def make(**tells: bool) -> tuple[Any, RsiTap]:
        cell = robot_cell()
        tap = RsiTap(cell.endpoints["rsi"], lambda: cell.world.arm().joints_rad, **tells)
        made.append((cell, tap))
        cell.endpoints["rsi"] = tap.endpoint
        return cell, tap

    yield make
    for cell, tap in made:
        for arm in cell.arms:
            arm.close()
        tap.close()


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run")
