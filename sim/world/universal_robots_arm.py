"""Nominal arms of Universal Robots: machine data as the vendor's robot descriptions give them.

Each joint turns about z of its own frame, which a displacement and three fixed angles place in the previous
one. Written independently of the kinematics that the drivers use.
"""

from __future__ import annotations

from math import acos, asin, atan2, cos, degrees, hypot, pi, sin

import numpy as np

from ronna_hw.arm.catalogue import UNIVERSAL_ROBOTS
from sim.world.nominal_arm import ORIGIN, ArmMake, Corner, NominalJoint, RobotDescription
from sim.world.rigid import Matrix, as_point, rotation_from_vector, vector_from_rotation

NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
RANGE_DEG = 360.0
ELBOW_RANGE_DEG = 180.0  # as planners of the field limit it (U)
FULL_SPEED_DEG_S = 180.0
ACCELERATION_DEG_S2 = degrees(40.0)  # the largest that a program may ask for: what the drives can do (U)

BEHIND, ELBOW_DOWN, WRIST_BACK = 1, 2, 4  # bits of a branch: base, elbow and wrist 2 solved the other way
POSTURES = (0, WRIST_BACK)  # of a procedure: elbow up, the head ahead of the base
STRAIGHT_WRIST = 1e-6  # sine of wrist 2 below which only the sum of wrist 1 and wrist 3 is defined

FAST_WRIST_DEG_S = (180.0, 180.0, 180.0, 360.0, 360.0, 360.0)  # of a UR3e
HEAVY_BASE_DEG_S = (120.0, 120.0, 180.0, 180.0, 180.0, 180.0)  # of a UR10e and a UR16e
TUBE_RADIUS_MM, WRIST_RADIUS_MM = 55.0, 40.0  # tubes of upper arm and forearm with their joints (U)
SMALL_RADII_MM, LARGE_RADII_MM = (43.0, 33.0), (68.0, 48.0)  # in proportion to the meshes of those arms (U)

# Place of each joint in the previous one's frame: x y z (m), roll pitch yaw (rad).
Place = tuple[tuple[float, float, float], tuple[float, float, float]]
UR5: tuple[Place, ...] = (
    ((0.0, 0.0, 0.089159), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (pi / 2, 0.0, 0.0)),
    ((-0.425, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((-0.39225, 0.0, 0.10915), (0.0, 0.0, 0.0)),
    ((0.0, -0.09465, 0.0), (pi / 2, 0.0, 0.0)),
    ((0.0, 0.0823, 0.0), (pi / 2, pi, pi)),
)
UR5E: tuple[Place, ...] = (
    ((0.0, 0.0, 0.1625), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (pi / 2, 0.0, 0.0)),
    ((-0.425, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((-0.3922, 0.0, 0.1333), (0.0, 0.0, 0.0)),
    ((0.0, -0.0997, 0.0), (pi / 2, 0.0, 0.0)),
    ((0.0, 0.0996, 0.0), (pi / 2, pi, pi)),
)
UR3E: tuple[Place, ...] = (
    ((0.0, 0.0, 0.15185), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (pi / 2, 0.0, 0.0)),
    ((-0.24355, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((-0.2132, 0.0, 0.13105), (0.0, 0.0, 0.0)),
    ((0.0, -0.08535, 0.0), (pi / 2, 0.0, 0.0)),
    ((0.0, 0.0921, 0.0), (pi / 2, pi, pi)),
)
UR10E: tuple[Place, ...] = (
    ((0.0, 0.0, 0.1807), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (pi / 2, 0.0, 0.0)),
    ((-0.6127, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((-0.57155, 0.0, 0.17415), (0.0, 0.0, 0.0)),
    ((0.0, -0.11985, 0.0), (pi / 2, 0.0, 0.0)),
    ((0.0, 0.11655, 0.0), (pi / 2, pi, pi)),
)
UR16E: tuple[Place, ...] = (
    ((0.0, 0.0, 0.1807), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (pi / 2, 0.0, 0.0)),
    ((-0.4784, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((-0.36, 0.0, 0.17415), (0.0, 0.0, 0.0)),
    ((0.0, -0.11985, 0.0), (pi / 2, 0.0, 0.0)),
    ((0.0, 0.11655, 0.0), (pi / 2, pi, pi)),
)


def _describe(
    variant: str,
    model: str,
    places: tuple[Place, ...],
    upper_arm_aside_mm: float,
    forearm_aside_mm: float,
    speeds_deg_s: tuple[float, ...] = (FULL_SPEED_DEG_S,) * len(NAMES),
    radii_mm: tuple[float, float] = (TUBE_RADIUS_MM, WRIST_RADIUS_MM),
) -> RobotDescription:
    """Express the joints in frames that are parallel to the base with all joints at zero.

    Where on its axis a joint lies is free. The errors of a true arm are those of its tubes, so the wrist's
    joints are drawn back along their axes to where the tube before meets them, and the flange follows.
    """
    turned, joints, ahead_mm = np.eye(3), [], np.zeros(3)
    tube_mm, wrist_mm = radii_mm
    for name, (xyz_m, (roll, pitch, yaw)), speed_deg_s in zip(NAMES, places, speeds_deg_s, strict=True):
        step_mm = ahead_mm + 1000.0 * turned @ np.array(xyz_m)
        turned = (
            turned
            @ rotation_from_vector((0.0, 0.0, yaw))
            @ rotation_from_vector((0.0, pitch, 0.0))
            @ rotation_from_vector((roll, 0.0, 0.0))
        )
        axis = turned[:, 2]
        ahead_mm = (step_mm @ axis) * axis if name.startswith("wrist") else np.zeros(3)
        end = ELBOW_RANGE_DEG if name == "elbow" else RANGE_DEG
        joints.append(
            NominalJoint(
                name,
                as_point(step_mm - ahead_mm),
                as_point(axis),
                -end,
                end,
                speed_deg_s,
                ACCELERATION_DEG_S2,
            )
        )
    return RobotDescription(
        _MAKE,
        variant,
        model,
        tuple(joints),
        flange_mm=as_point(ahead_mm),
        flange_turn_rad=as_point(vector_from_rotation(turned)),
        upper_arm_mm=-1000.0 * places[2][0][0],
        forearm_mm=-1000.0 * places[3][0][0],
        corners=(
            Corner(1, (0.0, -upper_arm_aside_mm, 0.0), tube_mm),
            Corner(2, (0.0, -upper_arm_aside_mm, 0.0), tube_mm),
            Corner(2, (0.0, -forearm_aside_mm, 0.0), tube_mm),
            Corner(3, (0.0, -forearm_aside_mm, 0.0), wrist_mm),
            Corner(4, ORIGIN, wrist_mm),
            Corner(5, ORIGIN, wrist_mm),
        ),
    )


def axes_of_branch(
    arm: RobotDescription, flange: Matrix, branch: int
) -> tuple[float, float, float, float, float, float] | None:
    """Return the joints (rad, modulo whole turns) for a flange pose (4, 4) in the base, in one branch.

    None if the pose is out of reach or leaves wrist 1 and wrist 3 undefined. The shoulder, elbow and wrist 1
    axes are parallel: the arm is solved in the plane across them, in which `u` points ahead and `v` up.
    """
    upper_mm, fore_mm = arm.joints[2].origin_mm[0], arm.joints[3].origin_mm[0]
    beside_mm, wrist_mm = -arm.joints[4].origin_mm[1], -arm.joints[5].origin_mm[2]
    flange_mm = -arm.flange_mm[1]
    x_axis, y_axis, z_axis = flange[:3, 0].tolist(), flange[:3, 1].tolist(), flange[:3, 2].tolist()
    x_mm, y_mm, z_mm = (flange[:3, 3] - flange_mm * flange[:3, 2]).tolist()
    out_mm = hypot(x_mm, y_mm)
    if out_mm <= beside_mm:
        return None
    aside = asin(beside_mm / out_mm)
    pan = atan2(y_mm, x_mm) + (pi - aside if branch & BEHIND else aside)
    s1, c1 = sin(pan), cos(pan)
    across = [s1 * x - c1 * y for x, y, _ in (x_axis, y_axis, z_axis)]  # shares along the parallel axes
    bend = acos(max(-1.0, min(1.0, across[2]))) * (-1.0 if branch & WRIST_BACK else 1.0)
    s5 = sin(bend)
    if abs(s5) < STRAIGHT_WRIST:
        return None
    last = atan2(-across[1] / s5, across[0] / s5)
    pitch = atan2(-z_axis[2] / s5, -(c1 * z_axis[0] + s1 * z_axis[1]) / s5)  # of the three parallel joints
    u_mm = c1 * x_mm + s1 * y_mm - wrist_mm * sin(pitch)
    v_mm = z_mm - arm.joints[0].origin_mm[2] + wrist_mm * cos(pitch)
    cosine = (u_mm**2 + v_mm**2 - upper_mm**2 - fore_mm**2) / (2.0 * upper_mm * fore_mm)
    if abs(cosine) > 1.0:
        return None
    elbow = acos(cosine) if bool(branch & ELBOW_DOWN) != bool(branch & BEHIND) else -acos(cosine)
    lift = atan2(v_mm, u_mm) - atan2(fore_mm * sin(elbow), upper_mm + fore_mm * cos(elbow))
    return pan, lift, elbow, pitch - lift - elbow, bend, last


_MAKE = ArmMake(UNIVERSAL_ROBOTS, "ur", POSTURES, axes_of_branch, senses_force=True)
DESCRIPTIONS = {
    arm.variant: arm
    for arm in (
        _describe("ur5", "UR5", UR5, 135.85, 16.5),
        _describe("ur5e", "UR5e", UR5E, 138.0, 7.0),
        _describe("ur3e", "UR3e", UR3E, 120.0, 27.0, FAST_WRIST_DEG_S, SMALL_RADII_MM),
        _describe("ur10e", "UR10e", UR10E, 176.2, 39.3, HEAVY_BASE_DEG_S, LARGE_RADII_MM),
        _describe("ur16e", "UR16e", UR16E, 176.0, 40.0, HEAVY_BASE_DEG_S, LARGE_RADII_MM),
    )
}
