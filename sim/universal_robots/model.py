"""Models of arm and generations of controller, with their Denavit-Hartenberg parameters and versions.

The parameters are those of the robot descriptions that also place the simulated arm, in metres: written
independently of the kinematics that the drivers use.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians
from typing import Final

from sim.world.options import UrArm
from sim.world.universal_robots_arm import FULL_SPEED_DEG_S, RANGE_DEG, UR5, UR5E, Place

JOINTS: Final = 6
Vector6 = tuple[float, float, float, float, float, float]

ALPHA_RAD: Final[Vector6] = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
ZEROS: Final[Vector6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
HOME_RAD: Final[Vector6] = (0.0, -pi / 2, -pi / 2, -pi / 2, pi / 2, -pi / 2)
JOINT_RANGE_RAD: Final = radians(RANGE_DEG)
FULL_SPEED_RAD_S: Final = radians(FULL_SPEED_DEG_S)
LARGEST_ACCELERATION_RAD_S2: Final = 40.0  # that a program may ask for


@dataclass(frozen=True)
class Model:
    """An arm with the controller that it is sold with."""

    name: UrArm
    d_m: Vector6
    a_m: Vector6
    cycle_s: float
    version: tuple[int, int, int, int]  # major, minor, bug fix, build
    realtime_doubles: int  # in a package of the real-time interface
    robot_type: int = 1  # UR5, and UR5e too
    controller_box: int = 1

    @property
    def rate_hz(self) -> int:
        """Rate of the control cycle and of RTDE."""
        return round(1.0 / self.cycle_s)

    @property
    def version_text(self) -> str:
        """Software version as on the dashboard."""
        return ".".join(map(str, self.version))


def _model(name: UrArm, places: tuple[Place, ...], **controller: object) -> Model:
    d1, a2, a3, d4 = places[0][0][2], places[2][0][0], places[3][0][0], places[3][0][2]
    d5, d6 = -places[4][0][1], places[5][0][1]
    return Model(
        name,
        d_m=(d1, 0.0, 0.0, d4, d5, d6),
        a_m=(0.0, a2, a3, 0.0, 0.0, 0.0),
        **controller,  # type: ignore[arg-type]
    )


MODELS: Final = {
    UrArm.UR5: _model(
        UrArm.UR5, UR5, cycle_s=0.008, version=(3, 15, 8, 106339), realtime_doubles=138, controller_box=1
    ),
    UrArm.UR5E: _model(
        UrArm.UR5E, UR5E, cycle_s=0.002, version=(5, 11, 5, 1010327), realtime_doubles=152, controller_box=2
    ),
}
