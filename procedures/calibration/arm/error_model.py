"""What is estimated of an arm, in units of what is expected of an uncalibrated one.

The vector holds the arm's deviations, then six numbers of the head on the flange, then three coordinates of
every sphere. Deviations and head are in units of their prior standard deviation, so that a covariance of 1
means: nothing was learnt. Spheres are in millimetres, without a prior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.calibration.arm.looks import LookArrays
from procedures.calibration.arm_geometry import (
    HARMONIC_RAD,
    JOINT_OFFSET_RAD,
    LINK_ROTATION_RAD,
    LINK_TRANSLATION_MM,
)
from ronna_hw.arm.deviations import ArmDeviations, flange_poses
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

# Parameter set S of the error study, as in `arm_geometry`; harmonics have an even phase.
SAG_RAD = math.radians(0.03)
BACKLASH_RAD = math.radians(0.02)
TOOL_MM = 2.0
TOOL_RAD = math.radians(0.5)  # a machined mount
TOOL = 6
BACKLASH = "backlash"  # in the name of a value
STEP = 1e-3  # of a derivative: of a prior, or of a millimetre


@dataclass(frozen=True)
class ArmModel:
    """The arm and head that looks are explained with: the nominal ones, and what may deviate."""

    kinematics: Kinematics
    flange_from_tool: Transform

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.kinematics.axis_names)

    @property
    def prior(self) -> Array:
        """One standard deviation of each value of the deviations' row; 0 where none is estimated."""
        count = self.joints
        harmonics = np.tile(np.array(HARMONIC_RAD) / math.sqrt(2.0), (count, 1))
        sag = np.zeros(count)
        sag[1 : count - 3] = SAG_RAD  # the joints of the wrist carry no lever, the first stands upright
        return ArmDeviations(
            np.full((count, 3), LINK_TRANSLATION_MM),
            np.full((count, 3), LINK_ROTATION_RAD),
            np.full(count, JOINT_OFFSET_RAD),
            harmonics,
            harmonics,
            sag,
            np.full(count, BACKLASH_RAD),
        ).flat()

    @property
    def size(self) -> int:
        """Length of the vector without spheres."""
        return int(np.count_nonzero(self.prior)) + TOOL

    @property
    def names(self) -> tuple[str, ...]:
        """What each value of the vector is, spheres apart."""
        axes = self.kinematics.axis_names
        named = [f"link {axis} {way}" for axis in axes for way in ("x", "y", "z")]
        named += [f"link {axis} turn {way}" for axis in axes for way in ("x", "y", "z")]
        named += [f"{axis} offset" for axis in axes]
        for what in ("sine", "cosine"):
            named += [f"{axis} {what} {order}" for axis in axes for order in ("once", "twice")]
        named += [f"{axis} sag" for axis in axes] + [f"{axis} {BACKLASH}" for axis in axes]
        kept = [name for name, sigma in zip(named, self.prior, strict=True) if sigma > 0.0]
        return (*kept, *(f"head {way}" for way in ("x", "y", "z", "turn x", "turn y", "turn z")))

    def deviations(self, values: Array) -> ArmDeviations:
        """The arm's part of a vector."""
        prior = self.prior
        row = np.zeros(len(prior))
        row[prior > 0.0] = values[: self.size - TOOL]
        return ArmDeviations.of_flat(row * prior, self.joints)

    def tool(self, values: Array) -> Transform:
        """FLANGE <- TOOL by a vector."""
        head = values[self.size - TOOL : self.size]
        change = RigidTransform.from_components(TOOL_MM * head[:3], Rotation.from_rotvec(TOOL_RAD * head[3:]))
        return Transform(Frame.FLANGE, Frame.TOOL, self.flange_from_tool.rigid * change)

    def misses(self, values: Array, looks: LookArrays) -> Array:
        """By how much each look puts its sphere beside the sphere's place, (m, 3) mm, robot frame."""
        flange = flange_poses(self.kinematics.chain, self.deviations(values), looks.joints_rad, looks.flanks)
        in_flange = self.tool(values).apply(looks.points_mm)
        seen = np.einsum("mij,mj->mi", flange[:, :3, :3], in_flange) + flange[:, :3, 3]
        return np.asarray(seen - values[self.size :].reshape(-1, 3)[looks.sphere])

    def slopes(self, values: Array, looks: LookArrays) -> Array:
        """Derivative (m, 3, n) of the misses by finite differences: they are nearly linear."""
        here = self.misses(values, looks)
        slopes = np.empty((*here.shape, len(values)))
        for column in range(len(values)):
            moved = values.copy()
            moved[column] += STEP
            slopes[:, :, column] = (self.misses(moved, looks) - here) / STEP
        return slopes

    def rotations(self, looks: LookArrays) -> Array:
        """Nominal orientation (m, 3, 3) ROBOT <- TOOL of each look."""
        nominal = ArmDeviations.none(self.joints)
        flange = flange_poses(self.kinematics.chain, nominal, looks.joints_rad)
        return np.asarray(flange[:, :3, :3] @ self.flange_from_tool.rotation_matrix)
