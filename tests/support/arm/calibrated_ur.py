"""Arms whose factory measured them: one for tests of what any arm promises, and simulated ones."""

from typing import Literal

from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS, UR5E
from ronna_hw.vectors import joint_vector
from sim.universal_robots.factory_calibration import calibrate
from sim.universal_robots.model import MODELS
from sim.world.scene.model import ArmTruth

CALIBRATION = FactoryCalibration(
    theta_rad=(1e-4, 1.2e-3, -8e-4, 5e-4, -3e-4, 2e-4),
    a_mm=(0.05, 0.4, -0.7, 0.03, -0.04, 0.02),
    d_mm=(0.3, 150.0, -149.0, -0.6, 0.1, 0.2),
    alpha_rad=(-3e-4, 4e-4, -5e-4, 3e-4, 2e-4, -1e-4),
)
CALIBRATED_UR = CalibratedUniversalRobot(DIMENSIONS[UR5E], CALIBRATION)


def stated_kinematics(
    truth: ArmTruth, seed: int, kind: Literal["linearised", "exact", "none"] = "linearised"
) -> CalibratedUniversalRobot:
    """Return what a driver computes of a simulated arm from the parameters that its controller sends."""
    arm = DIMENSIONS[truth.variant]
    stated = calibrate(MODELS[truth.variant], truth, seed, kind)
    a_mm, d_mm = (joint_vector(1000.0 * value for value in row) for row in (stated.a_m, stated.d_m))
    theta_rad, alpha_rad = joint_vector(stated.theta_rad), joint_vector(stated.alpha_rad)
    return CalibratedUniversalRobot(
        arm, FactoryCalibration.from_parameters(arm, theta_rad, a_mm, d_mm, alpha_rad)
    )
