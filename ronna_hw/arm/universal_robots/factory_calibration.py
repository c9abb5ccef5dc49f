"""Kinematic calibration that the factory measures for each arm, and the chain it describes.

The controller states it as changes of the four Denavit-Hartenberg columns. The second, third and fourth axis
of these arms are parallel by design, and real ones nearly so: the common normal of two nearly parallel lines
lies wherever they happen to come closest, so that a true arm may have d2 = 439 m and d3 = -446 m.

`reduce_chain` removes such numbers without changing the arm. A joint's rotation about its axis commutes with
every screw S along the same axis, a shift and a turn: Rz(q) = S Rz(q) S^-1. With a screw S_i on every axis

    Rz(q1) C1 Rz(q2) C2 .. Rz(q6) C6  =  Rz(q1) K1 Rz(q2) K2 .. Rz(q6) K6,   K_i = S_i^-1 C_i S_(i+1),

where C_i = Rz(theta) Tz(d) Tx(a) Rx(alpha) is constant, and S_1 and S_7, at base and flange, are identities.
The screws are free. From the base outwards, each is the one that brings the next frame closest to the nominal
one: its shift is the distance along the axis to the point nearest the nominal origin, its turn aligns x. What
an arm's axes really deviate by remains in K, fractions of a millimetre and of a degree, and joint angles are
unchanged. Hundreds of metres in doubles cost below 1e-9 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, isfinite, sin

from ronna_hw.arm.errors import CALIBRATION_OF_ANOTHER_ARM
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.universal_robots.geometry import ALPHA_RAD, Dimensions
from ronna_hw.vectors import JointVector, joint_vector

ZEROS: JointVector = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

# A calibrated arm differs from its model by "multiple millimeters" (the vendor); the two models differ by at
# least 24 mm at shoulder and wrist. Beyond these the record is of another arm, or its bytes are misread (U).
LARGEST_DEVIATION_MM = 10.0
LARGEST_DEVIATION_RAD = 0.05


@dataclass(frozen=True)
class FactoryCalibration:
    """Differences between an arm's Denavit-Hartenberg parameters and its model's, base to flange."""

    theta_rad: JointVector = ZEROS
    a_mm: JointVector = ZEROS
    d_mm: JointVector = ZEROS
    alpha_rad: JointVector = ZEROS

    @classmethod
    def from_parameters(
        cls,
        arm: Dimensions,
        theta_rad: JointVector,
        a_mm: JointVector,
        d_mm: JointVector,
        alpha_rad: JointVector,
    ) -> FactoryCalibration:
        """Build from the sums of nominal value and difference, as the primary interface sends them."""
        nominal_a = (link.position_mm[0] for link in arm.links)
        nominal_d = (link.position_mm[2] for link in arm.links)
        return cls(
            theta_rad,
            joint_vector(a - b for a, b in zip(a_mm, nominal_a, strict=True)),
            joint_vector(a - b for a, b in zip(d_mm, nominal_d, strict=True)),
            joint_vector(a - b for a, b in zip(alpha_rad, ALPHA_RAD, strict=True)),
        )

    def links(self, arm: Dimensions) -> tuple[Pose, ...]:
        """Return the constant transforms C1 .. C6 of the parameters as they are."""
        return tuple(
            _denavit_hartenberg(
                theta, nominal.position_mm[2] + d, nominal.position_mm[0] + a, nominal_alpha + alpha
            )
            for nominal, nominal_alpha, theta, a, d, alpha in zip(
                arm.links, ALPHA_RAD, self.theta_rad, self.a_mm, self.d_mm, self.alpha_rad, strict=True
            )
        )


def reduce_chain(arm: Dimensions, calibration: FactoryCalibration) -> tuple[Pose, ...]:
    """Return the transforms K1 .. K6 of the same arm that are closest to the nominal ones.

    Raises ARM-010 if a joint's frame is farther from the model's than a calibration can explain.
    """
    values = (*calibration.theta_rad, *calibration.a_mm, *calibration.d_mm, *calibration.alpha_rad)
    if not all(map(isfinite, values)):
        raise CALIBRATION_OF_ANOTHER_ARM("the factory calibration contains a number that is not finite")
    reduced = []
    unscrewed = Pose()  # S_i^-1
    for number, (link, nominal) in enumerate(zip(calibration.links(arm), arm.links, strict=True), start=1):
        here = unscrewed.compose(link)
        if number < len(arm.links):
            screw = _screw_towards(here, nominal)
            here, unscrewed = here.compose(screw), screw.inverse()
        _require_close(arm, number, here, nominal)
        reduced.append(here)
    return tuple(reduced)


def _denavit_hartenberg(theta: float, d_mm: float, a_mm: float, alpha: float) -> Pose:
    c, s, ca, sa = cos(theta), sin(theta), cos(alpha), sin(alpha)
    return Pose((a_mm * c, a_mm * s, d_mm), (c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca))


def _screw_towards(here: Pose, nominal: Pose) -> Pose:
    """Return the screw along z of `here` that brings its origin and x axis closest to those of `nominal`."""
    gap = [there - mine for there, mine in zip(nominal.position_mm, here.position_mm, strict=True)]
    r, wanted = here.rotation, nominal.rotation
    shift_mm = gap[0] * r[2] + gap[1] * r[5] + gap[2] * r[8]
    along_x = wanted[0] * r[0] + wanted[3] * r[3] + wanted[6] * r[6]
    along_y = wanted[0] * r[1] + wanted[3] * r[4] + wanted[6] * r[7]
    turn = atan2(along_y, along_x)
    c, s = cos(turn), sin(turn)
    return Pose((0.0, 0.0, shift_mm), (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0))


def _require_close(arm: Dimensions, number: int, here: Pose, nominal: Pose) -> None:
    away_mm, turned_rad = here.distance_mm(nominal), here.angle_rad(nominal)
    if away_mm > LARGEST_DEVIATION_MM or turned_rad > LARGEST_DEVIATION_RAD:
        raise CALIBRATION_OF_ANOTHER_ARM(
            f"the factory calibration does not fit {arm.name}: link {number} is not where the model has it",
            limit=f"{LARGEST_DEVIATION_MM:g} mm and {LARGEST_DEVIATION_RAD:g} rad",
            got=f"{away_mm:.3g} mm and {turned_rad:.3g} rad",
        )
