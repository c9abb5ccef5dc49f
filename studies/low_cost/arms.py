"""The arms of the experiment: one in this process, and one behind its driver and a simulated controller.

The first is at its target at once, so that many arms can be studied. The second is a theatre's: motions are
planned and monitored, set-points streamed over RTDE, theatre time passes in lock-step with the tracker.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol, cast

import numpy as np

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS
from ronna_hw.clock import Clock, open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import ArmReading, Stamp, Validity
from ronna_hw.devices.robot import JointMove, RobotArm
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_address
from ronna_hw.registry import make_device
from ronna_hw.vectors import JointVector, joint_vector
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.factory_calibration import calibrate
from sim.universal_robots.model import MODELS
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState, World

AT_REST = (0.0,) * 6
ENDPOINTS = ("rtde", "dashboard", "primary")  # that the driver needs
SETTLING_S = 0.2  # theatre time after a motion: joints still creep into their last thousandth of a degree
# Host time, as safeguards: in lock-step a busy computer only makes a cycle late.
START_LIMIT_S, SILENCE_LIMIT_S, HEARTBEAT_LIMIT_S = 60.0, 30.0, 30.0


class PositionedArm(Protocol):
    """Part of `RobotArm` that the experiment uses."""

    def move(self, motion: JointMove, *, timeout_s: float = 60.0) -> ArmReading:
        """Move all joints together to rest at the target and return the settled reading."""
        ...


def factory_kinematics(truth: ArmTruth, seed: int) -> CalibratedUniversalRobot:
    """Return the kinematics that an arm's controller states: as the factory measured this arm."""
    arm = DIMENSIONS[truth.variant]
    stated = calibrate(MODELS[truth.variant], truth, seed, ControllerParameters().factory_calibration)
    a_mm, d_mm = (joint_vector(1000.0 * value for value in row) for row in (stated.a_m, stated.d_m))
    return CalibratedUniversalRobot(
        arm,
        FactoryCalibration.from_parameters(
            arm, joint_vector(stated.theta_rad), a_mm, d_mm, joint_vector(stated.alpha_rad)
        ),
    )


class InstantArm:
    """True UR5 that is at its target at once: neither path nor time, but errors, lost motion and scatter."""

    def __init__(self, truth: ArmTruth, world: World, seed: int) -> None:
        self._true = TrueArm(truth, seed)
        self._world = world
        self._motions = 0
        self._flanks: JointVector = AT_REST
        self._joints_rad = joint_vector(np.radians(truth.home_deg))
        self._publish()

    def move(self, motion: JointMove, *, timeout_s: float = 60.0) -> ArmReading:
        del timeout_s
        target_rad = motion.target_rad
        moved = np.sign(np.subtract(target_rad, self._joints_rad))
        self._flanks = joint_vector(np.where(moved == 0.0, self._flanks, moved))
        self._joints_rad = target_rad
        self._motions += 1
        self._publish()
        now_s = self._world.clock.now_s()
        stamp = Stamp(self._motions, self._motions, now_s, now_s)
        return ArmReading(stamp, Validity.OK, target_rad, target_rad, moving=False)

    def _publish(self) -> None:
        flange = self._true.at_rest(self._joints_rad, self._flanks, self._motions)
        self._world.publish_arm(ArmState(self._joints_rad, flange, self._motions, True, self._flanks))


class DrivenArm:
    """Arm behind its driver, which after each motion is given time to settle."""

    def __init__(self, arm: RobotArm, clock: Clock) -> None:
        self._arm = arm
        self._clock = clock

    @property
    def kinematics(self) -> Kinematics:
        """Kinematics that the controller states: as the factory measured this arm."""
        return self._arm.kinematics

    def move(self, motion: JointMove, *, timeout_s: float = 60.0) -> ArmReading:
        self._arm.move(motion, timeout_s=timeout_s)
        self._clock.sleep(SETTLING_S)
        return self._arm.read_state()


@contextmanager
def drive_arm(world: World) -> Iterator[DrivenArm]:
    """Start the controller of the arm in a world's scene, and stream to it by our driver.

    Raises PRC-001 and the driver's errors.
    """
    model = world.scene.arm.variant
    arguments = command(
        *("sim.cli", "ur", "--model", model, "--address", own_address()),
        *("--world", world.endpoint),
    )
    with ExitStack() as stack:
        controller = stack.enter_context(ChildProcess("ronna-sim ur", arguments))
        config = DeviceConfig(
            driver="universal_robots",
            endpoints={role: controller.ready["endpoints"][role] for role in ENDPOINTS},
            options={
                "model": model,
                "silence_limit_s": SILENCE_LIMIT_S,
                "heartbeat_limit_s": HEARTBEAT_LIMIT_S,
            },
        )
        clock = open_clock(world.clock_endpoint)
        arm = cast("RobotArm", make_device("robot", config, clock))
        stack.callback(arm.close)
        stack.enter_context(arm.active(START_LIMIT_S))
        yield DrivenArm(arm, clock)
