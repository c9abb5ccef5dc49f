"""Each size of the e-Series is driven as the UR5e is, and refused where another one is expected."""

from __future__ import annotations

from contextlib import ExitStack, closing
from math import radians

import pytest
from coded_errors import raises
from ur_clients import UrCell

from drivers.universal_robots import UniversalRobotsArm
from drivers.universal_robots.errors import WRONG_ARM
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.robot import JointMove

TURNED_RAD = radians(15.0)
LIMIT_S = 30.0


@pytest.mark.parametrize("model", ["ur3e", "ur10e", "ur16e"])
def test_a_size_of_the_e_series_is_identified_and_moved(model: str) -> None:
    with ExitStack() as stack:
        cell = UrCell(stack, "--model", model, "--lock-step")
        endpoints = {name: cell.endpoints[name] for name in ("rtde", "dashboard", "primary")}

        def arm_of(expected: str) -> UniversalRobotsArm:
            config = DeviceConfig(
                driver="universal_robots",
                endpoints=endpoints,
                options={"model": expected, "silence_limit_s": 2.0},
            )
            return stack.enter_context(closing(UniversalRobotsArm("robot.master", config, HostClock())))

        with raises(WRONG_ARM, match="expected option model, ur5e"):
            arm_of("ur5e").connect(LIMIT_S)
        arm = arm_of(model)
        assert arm.connect(LIMIT_S).model == model
        arm.configure(LIMIT_S)
        with arm.active(LIMIT_S):
            target = tuple(angle + TURNED_RAD for angle in arm.read_state().joints_rad)
            reached = arm.move(JointMove(target)).joints_rad
        assert reached == pytest.approx(target, abs=1e-4)
