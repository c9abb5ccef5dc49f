"""urx, which reads the robot state of version 3.2 on port 30002. LGPL: only ever in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from simulated_peer import eventually, inject
from urx.urrobot import URRobot  # type: ignore[import-untyped]

SIX_DIGITS = 1e-5  # with which it writes numbers


def connected() -> Any:
    return URRobot(os.environ["ARM"])


def are_near(values: Sequence[float], wanted: Sequence[float]) -> bool:
    return max(abs(a - b) for a, b in zip(values, wanted, strict=True)) < SIX_DIGITS


def reads_joints_and_pose() -> None:
    robot = connected()
    assert len(robot.getj()) == 6
    assert any(robot.getl()[:3])


def moves_to_joints() -> None:
    robot = connected()
    start = robot.getj()
    goal = [start[0] + 0.1, *start[1:]]
    robot.movej(goal, acc=10, vel=2)
    assert are_near(robot.getj(), goal)


def moves_along_a_line() -> None:
    robot = connected()
    goal = robot.getl()
    goal[2] += 0.02
    robot.movel(goal, acc=5, vel=0.5)
    assert are_near(robot.getl()[:3], goal[:3])


def stops_a_motion() -> None:
    robot = connected()
    start = robot.getj()
    robot.movej([start[0] + 1.0, *start[1:]], acc=1, vel=0.5, wait=False)
    assert eventually(lambda: robot.getj()[0] > start[0] + 0.01)
    robot.stopj(10)
    assert eventually(lambda: robot.getj() == robot.getj() and not robot.is_program_running())
    assert robot.getj()[0] < start[0] + 0.9


def sets_the_tool_centre_point() -> None:
    robot = connected()
    before = robot.getl()
    robot.set_tcp((0, 0, 0.1, 0, 0, 0))
    assert eventually(lambda: not are_near(robot.getl()[:3], before[:3])), "the pose stays as it was"


def switches_an_output() -> None:
    robot = connected()
    robot.set_digital_out(1, True)
    assert eventually(lambda: robot.get_digital_out(1)), "its call writes `digital_out[1]=True`, no URScript"


def sends_a_script() -> None:
    robot = connected()
    robot.send_program("set_digital_out(1, True)")
    assert eventually(lambda: robot.get_digital_out(1))


def tells_a_protective_stop() -> None:
    robot = connected()
    assert robot.is_running()
    inject("ur protective stop")
    assert eventually(
        lambda: (
            not robot.is_running()
            or robot.secmon.get_all_data()["RobotModeData"][
                "isProtectiveStopped"
                if "isProtectiveStopped" in robot.secmon.get_all_data()["RobotModeData"]
                else "isSecurityStopped"
            ]
        )
    )


def tells_that_the_controller_has_gone() -> None:
    robot = connected()
    inject("ur cable pulled")
    try:
        for _ in range(3):
            robot.getj(wait=True)
    except Exception:
        return
    raise AssertionError("it goes on to show the last state")
