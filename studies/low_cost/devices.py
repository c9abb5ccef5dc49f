"""The simulated devices: a Vicra read by its driver over the wire, and a UR5 in this process.

The arm offers what the experiment needs of a `RobotArm`, so that one behind a driver can take its place.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from ronna_hw import patient_frame
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS, UrModel
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import ArmReading, Stamp, Validity
from ronna_hw.devices.sensors import OpticalTracker
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.registry import make_device
from ronna_hw.vectors import JointVector, joint_vector
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.factory_calibration import calibrate
from sim.universal_robots.model import MODELS, ArmName
from sim.world.rigid import Matrix, inverse, matrix_of
from sim.world.scene.model import ArmTruth, Scene
from sim.world.true_arm import TrueArm
from sim.world.world import ArmState, World

Array = NDArray[np.float64]

TOOL_FRAME, PHANTOM_FRAME = "robot_frame", patient_frame.NAME  # definitions shipped with the driver
VICRA_HZ = 20
NO_TOOL = 0  # the pointer is no tool of the theatre's: it hides nothing
# Host time, as safeguards: in lock-step a busy computer only makes a frame late.
START_LIMIT_S, FRAME_LIMIT_S = 60.0, 30.0
AT_REST = (0.0,) * 6


def factory_kinematics(truth: ArmTruth, seed: int) -> CalibratedUniversalRobot:
    """Return the kinematics that an arm's controller states: as the factory measured this arm."""
    arm = DIMENSIONS[UrModel(truth.variant)]
    stated = calibrate(
        MODELS[ArmName(truth.variant)], truth, seed, ControllerParameters().factory_calibration
    )
    a_mm, d_mm = (joint_vector(1000.0 * value for value in row) for row in (stated.a_m, stated.d_m))
    return CalibratedUniversalRobot(
        arm,
        FactoryCalibration.from_parameters(
            arm, joint_vector(stated.theta_rad), a_mm, d_mm, joint_vector(stated.alpha_rad)
        ),
    )


class PositionedArm(Protocol):
    """What the experiment needs of an arm: `RobotArm` offers it."""

    def move_joints(
        self, target_rad: JointVector, *, speed_fraction: float = 1.0, timeout_s: float = 60.0
    ) -> ArmReading:
        """Move all joints together to rest at the target and return the settled reading."""
        ...


class InstantArm:
    """True UR5 that is at its target at once: neither path nor time, but errors, lost motion and scatter."""

    def __init__(self, truth: ArmTruth, world: World, seed: int) -> None:
        self._true = TrueArm(truth, seed)
        self._world = world
        self._motions = 0
        self._flanks = AT_REST
        self._joints_rad = joint_vector(np.radians(truth.home_deg))
        self._publish()

    def move_joints(
        self, target_rad: JointVector, *, speed_fraction: float = 1.0, timeout_s: float = 60.0
    ) -> ArmReading:
        del speed_fraction, timeout_s
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


class Hand:
    """A person who holds the tool in view of the tracker, without an arm."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._from_tool = inverse(matrix_of(world.scene.mount.flange_from_tool_true))
        self._moved = 0

    def hold(self, robot_from_tip: Matrix) -> None:
        """Hold the tool still at a true pose (4, 4) of its tip."""
        self._moved += 1
        self._world.publish_arm(ArmState(AT_REST, robot_from_tip @ self._from_tool, self._moved, True))


@contextmanager
def open_room(scene: Scene) -> Iterator[tuple[World, OpticalTracker]]:
    """Start a simulated Vicra in a world of its own, in lock-step, and track both frames. Raises PRC-001."""
    world = World.create(scene, paced=False)
    world.mount_tool(NO_TOOL)
    arguments = command(
        *("sim.cli", "polaris", "--profile", "vicra"),
        *("--endpoint", "tcp://127.0.0.1:0", "--world", world.endpoint),
    )
    with ExitStack() as stack:
        unit = stack.enter_context(ChildProcess("ronna-sim polaris", arguments))
        config = DeviceConfig(
            driver="ndi_polaris",
            endpoint=unit.ready["endpoint"],
            options={
                "tools": [{"name": name, "rom": f"{name}.rom"} for name in (TOOL_FRAME, PHANTOM_FRAME)],
                "expected_model": "vicra",
                "illuminator_rate_hz": VICRA_HZ,
                "time_limits_s": {"BX": FRAME_LIMIT_S},
            },
        )
        clock = open_clock(world.clock_endpoint)
        tracker = cast("OpticalTracker", make_device("tracker", config, clock))
        stack.callback(tracker.close)
        stack.enter_context(tracker.active(START_LIMIT_S))
        yield world, tracker
