"""Targets, a long motion under way, and the largest step sent, for tests of the driver's arm."""

from __future__ import annotations

import threading
from itertools import pairwise
from math import degrees
from typing import Any

from waiting import eventually

from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.pose import radians6
from ronna_hw.devices.robot import JointMove

CYCLE_S = 0.004
MODEL = kr6_r900("kr6_r900_sixx")
THERE = radians6(10, -85, 85, 5, 65, -10)
FAR = radians6(60, -60, 60, 30, 80, 90)


def configured(arm: Any) -> Any:
    arm.connect()
    arm.configure()
    return arm


def activated(arm: Any) -> Any:
    configured(arm).activate()
    return arm


def largest_step(replies: list[tuple[int, tuple[float, ...], int]]) -> float:
    """Return the largest step of a command over the full-speed step of its axis."""
    worst = 0.0
    for (_, a, _), (_, b, _) in pairwise(replies):
        for axis in range(6):
            full = degrees(MODEL.full_speed_rad_s[axis]) * CYCLE_S
            worst = max(worst, abs(b[axis] - a[axis]) / full)
    return worst


def moving(arm: Any, controller: Any) -> tuple[threading.Thread, list[BaseException]]:
    """Start a long motion in a thread of its own; return when it is well under way."""
    controller.pace_s = 0.001
    caught: list[BaseException] = []

    def move() -> None:
        try:
            arm.move(JointMove(FAR))
        except BaseException as error:
            caught.append(error)

    thread = threading.Thread(target=move)
    thread.start()
    eventually(lambda: len(controller.replies) > 2 and abs(controller.replies[-1][1][0]) > 2.0)
    return thread, caught
