"""Settings of the real-time process."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.arm.universal_robots import UniversalRobot, universal_robot
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm_stream.records import StreamSettings
from ronna_hw.vectors import joint_vector

COLUMNS = 4  # of the Denavit-Hartenberg parameters, six numbers each


@dataclass(frozen=True, kw_only=True)
class LinkSettings(StreamSettings):
    """Settings of the RTDE link, passed as one line of JSON on standard input."""

    handover_fd: int  # local socket over which connections to the controller arrive
    model: str
    cycle_s: float
    starved_cycles: int  # without a new set-point, after which the script says that it ends
    calibration: tuple[float, ...] = ()  # columns of the factory calibration, one after the other

    def kinematics(self) -> UniversalRobot:
        """Return the kinematics of this individual arm; raises ARM-010."""
        return build_kinematics(self.model, self.calibration)


def build_kinematics(model: str, calibration: tuple[float, ...]) -> UniversalRobot:
    """Return the kinematics of an arm by the columns of its factory calibration, nominal without them.

    Raises ARM-010.
    """
    nominal = universal_robot(model)
    if not calibration:
        return nominal
    columns = [joint_vector(calibration[6 * k : 6 * k + 6]) for k in range(COLUMNS)]
    return CalibratedUniversalRobot(nominal.dimensions, FactoryCalibration(*columns))
