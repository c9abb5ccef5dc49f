"""A UR5e whose factory measured it, for tests of what any arm promises."""

from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS, UrModel

CALIBRATION = FactoryCalibration(
    theta_rad=(1e-4, 1.2e-3, -8e-4, 5e-4, -3e-4, 2e-4),
    a_mm=(0.05, 0.4, -0.7, 0.03, -0.04, 0.02),
    d_mm=(0.3, 150.0, -149.0, -0.6, 0.1, 0.2),
    alpha_rad=(-3e-4, 4e-4, -5e-4, 3e-4, 2e-4, -1e-4),
)
CALIBRATED_UR = CalibratedUniversalRobot(DIMENSIONS[UrModel.UR5E], CALIBRATION)
