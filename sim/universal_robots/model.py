"""Models of arm and generations of controller, with their Denavit-Hartenberg parameters and versions.

The parameters are those of the robot descriptions that also place the simulated arm, in metres: written
independently of the kinematics that the drivers use.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi, radians
from typing import Any, Final

from ronna_hw.wire.universal_robots_services import ARM_TYPE
from sim.world.universal_robots_arm import (
    FAST_WRIST_DEG_S,
    FULL_SPEED_DEG_S,
    HEAVY_BASE_DEG_S,
    RANGE_DEG,
    UR3E,
    UR5,
    UR5E,
    UR10E,
    UR16E,
    Place,
)

JOINTS: Final = 6
Vector6 = tuple[float, float, float, float, float, float]

ALPHA_RAD: Final[Vector6] = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
ZEROS: Final[Vector6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
HOME_RAD: Final[Vector6] = (0.0, -pi / 2, -pi / 2, -pi / 2, pi / 2, -pi / 2)
JOINT_RANGE_RAD: Final = radians(RANGE_DEG)
FULL_SPEED_RAD_S: Final = radians(FULL_SPEED_DEG_S)
LARGEST_ACCELERATION_RAD_S2: Final = 40.0  # that a program may ask for
TORQUES_NM: Final[Vector6] = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
LINK_CENTRES_M: Final = (
    (0.0, -0.02561, 0.00193),
    (0.2125, 0.0, 0.11336),
    (0.15, 0.0, 0.0265),
    (0.0, -0.0018, 0.01634),
    (0.0, 0.0018, 0.01634),
    (0.0, 0.0, -0.001159),
)


E_SERIES_MAJOR: Final = 5  # of its software


@dataclass(frozen=True)
class Model:
    """An arm with the controller that it is sold with."""

    name: str
    d_m: Vector6
    a_m: Vector6
    cycle_s: float
    version: tuple[int, int, int, int]  # major, minor, bug fix, build
    realtime_doubles: int  # in a package of the real-time interface
    link_masses_kg: Vector6
    # Noise of one cycle, and largest error of the estimated force on each axis (U). CB3 estimates it from
    # currents; the e-Series has a sensor in the flange, of 3.5 N precision by its data sheet.
    force_noise_N: float
    force_bias_N: float
    robot_type: int = 1  # UR5, and UR5e too
    controller_box: int = 1
    dashboard_name: str = ARM_TYPE
    full_speed_rad_s: Vector6 = (FULL_SPEED_RAD_S,) * JOINTS
    torques_nm: Vector6 = TORQUES_NM  # largest of each joint
    link_centres_m: tuple[tuple[float, float, float], ...] = LINK_CENTRES_M  # in the frame of each joint

    @property
    def rate_hz(self) -> int:
        """Rate of the control cycle and of RTDE."""
        return round(1.0 / self.cycle_s)

    @property
    def version_text(self) -> str:
        """Software version as on the dashboard."""
        return ".".join(map(str, self.version))

    def with_software(self, version: str) -> Model:
        """Return the model with a later version of its software, but for `usual` and for a CB3."""
        if version == "usual" or self.version[0] < E_SERIES_MAJOR:
            return self
        major, minor, bug_fix = map(int, version.split("."))
        return replace(self, version=(major, minor, bug_fix, self.version[3]))


def _radians(speeds_deg_s: tuple[float, ...]) -> Vector6:
    a, b, c, d, e, f = map(radians, speeds_deg_s)
    return a, b, c, d, e, f


# Sizes of the e-Series beside the UR5e. Masses and their centres: the vendor's page on Denavit-Hartenberg
# parameters; torques: its robot descriptions. Controller and noise are assumed to be those of the UR5e (U).
_E_SERIES: Final[dict[str, Any]] = {
    "cycle_s": 0.002,
    "version": (5, 11, 5, 1010327),
    "realtime_doubles": 152,
    "controller_box": 2,
    "force_noise_N": 0.5,
    "force_bias_N": 2.0,
}


def _model(name: str, places: tuple[Place, ...], **controller: object) -> Model:
    d1, a2, a3, d4 = places[0][0][2], places[2][0][0], places[3][0][0], places[3][0][2]
    d5, d6 = -places[4][0][1], places[5][0][1]
    return Model(
        name,
        d_m=(d1, 0.0, 0.0, d4, d5, d6),
        a_m=(0.0, a2, a3, 0.0, 0.0, 0.0),
        **controller,  # type: ignore[arg-type]
    )


MODELS: Final = {
    model.name: model
    for model in (
        _model(
            "ur5",
            UR5,
            cycle_s=0.008,
            version=(3, 15, 8, 106339),
            realtime_doubles=138,
            controller_box=1,
            link_masses_kg=(3.7, 8.393, 2.275, 1.219, 1.219, 0.1879),
            force_noise_N=3.0,
            force_bias_N=5.0,
        ),
        _model(
            "ur5e",
            UR5E,
            cycle_s=0.002,
            version=(5, 11, 5, 1010327),
            realtime_doubles=152,
            controller_box=2,
            link_masses_kg=(3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
            force_noise_N=0.5,
            force_bias_N=2.0,
        ),
        _model(
            "ur3e",
            UR3E,
            **_E_SERIES,
            robot_type=3,
            dashboard_name="UR3",
            full_speed_rad_s=_radians(FAST_WRIST_DEG_S),
            torques_nm=(54.0, 54.0, 28.0, 9.0, 9.0, 9.0),
            link_masses_kg=(1.98, 3.4445, 1.437, 0.871, 0.805, 0.261),
            link_centres_m=(
                (0.0, -0.02, 0.0),
                (0.13, 0.0, 0.1157),
                (0.05, 0.0, 0.0238),
                (0.0, 0.0, 0.01),
                (0.0, 0.0, 0.01),
                (0.0, 0.0, -0.02),
            ),
        ),
        _model(
            "ur10e",
            UR10E,
            **_E_SERIES,
            robot_type=2,
            dashboard_name="UR10",
            full_speed_rad_s=_radians(HEAVY_BASE_DEG_S),
            torques_nm=(330.0, 330.0, 150.0, 54.0, 54.0, 54.0),
            link_masses_kg=(7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
            link_centres_m=(
                (0.021, 0.0, 0.027),
                (0.38, 0.0, 0.158),
                (0.24, 0.0, 0.068),
                (0.0, 0.007, 0.018),
                (0.0, 0.007, 0.018),
                (0.0, 0.0, -0.026),
            ),
        ),
        _model(
            "ur16e",
            UR16E,
            **_E_SERIES,
            robot_type=4,
            dashboard_name="UR16",
            full_speed_rad_s=_radians(HEAVY_BASE_DEG_S),
            torques_nm=(330.0, 330.0, 150.0, 54.0, 54.0, 54.0),
            link_masses_kg=(7.369, 10.45, 4.321, 2.18, 2.033, 0.907),
            link_centres_m=(
                (0.0, -0.016, 0.03),
                (0.302, 0.0, 0.16),
                (0.194, 0.0, 0.065),
                (0.0, -0.009, 0.011),
                (0.0, 0.018, 0.012),
                (0.0, 0.0, -0.044),
            ),
        ),
    )
}
