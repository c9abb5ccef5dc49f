"""The arm parameters to estimate, in units of what is expected of an uncalibrated arm.

The vector consists of the arm's deviations, six parameters of the head on the flange, and three coordinates
per sphere. Deviations and head are in units of their prior standard deviation, so that a covariance of 1
means that nothing was learnt. Spheres are in millimetres, without a prior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

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
from ronna_hw.arm.deviations import ArmDeviations, flange_poses, flange_rotations, gravity_levers
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

# Parameter set S of the error study, as in `arm_geometry`; harmonics have an arbitrary phase.
SAG_RAD = math.radians(0.03)
BACKLASH_RAD = math.radians(0.02)
TOOL_MM = 2.0
TOOL_RAD = math.radians(0.5)  # a machined mount
TOOL = 6
BACKLASH = "backlash"  # part of a parameter's name
STEP = 1e-3  # of a numerical derivative: in units of a prior, or mm


@dataclass(frozen=True)
class ArmModel:
    """The model of arm and head behind the measurements: nominal values, and what may deviate."""

    kinematics: Kinematics
    flange_from_tool: Transform

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.kinematics.axis_names)

    @cached_property
    def prior(self) -> Array:
        """Prior standard deviation of each deviation, in order; 0 for those not estimated."""
        count = self.joints
        harmonics = np.tile(np.array(HARMONIC_RAD) / math.sqrt(2.0), (count, 1))
        sag = np.zeros(count)
        sag[1 : count - 3] = SAG_RAD  # the wrist joints have no lever arm, the first axis is vertical
        return ArmDeviations(
            np.full((count, 3), LINK_TRANSLATION_MM),
            np.full((count, 3), LINK_ROTATION_RAD),
            np.full(count, JOINT_OFFSET_RAD),
            harmonics,
            harmonics,
            sag,
            np.full(count, BACKLASH_RAD),
        ).flat()

    @cached_property
    def size(self) -> int:
        """Length of the vector without spheres."""
        return int(np.count_nonzero(self.prior)) + TOOL

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each element of the vector, without spheres."""
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
        """FLANGE <- TOOL according to a vector."""
        head = values[self.size - TOOL : self.size]
        change = RigidTransform.from_components(TOOL_MM * head[:3], Rotation.from_rotvec(TOOL_RAD * head[3:]))
        return Transform(Frame.FLANGE, Frame.TOOL, self.flange_from_tool.rigid * change)

    @property
    def to_record(self) -> Array:
        """Derivative (k, size) of what a record of the arm states by a vector without spheres.

        All deviations, then the head on the flange in mm. A turn of the head moves no sphere that it is
        centred on.
        """
        prior = self.prior
        arm, head = len(prior), self.size - TOOL
        rows = np.zeros((arm + 3, self.size))
        rows[np.flatnonzero(prior), np.arange(head)] = prior[prior > 0.0]
        rows[arm:, head : head + 3] = TOOL_MM * self.flange_from_tool.rotation_matrix
        return rows

    def misses(self, values: Array, looks: LookArrays) -> Array:
        """Deviation of each measurement from its sphere's position, (m, 3) mm, robot frame."""
        flange = self._flange(values, looks, self._levers(looks))
        return self._missed(values, looks, flange, self._in_flange(values, looks))

    def slopes(self, values: Array, looks: LookArrays) -> Array:
        """Derivative (m, 3, n) of the misses by finite differences; they are nearly linear."""
        levers = self._levers(looks)
        flange, in_flange = self._flange(values, looks, levers), self._in_flange(values, looks)
        here = self._missed(values, looks, flange, in_flange)
        slopes = np.empty((*here.shape, len(values)))
        for column in range(len(values)):
            moved = values.copy()
            moved[column] += STEP
            of_arm = column < self.size - TOOL
            of_tool = not of_arm and column < self.size
            misses = self._missed(
                moved,
                looks,
                self._flange(moved, looks, levers) if of_arm else flange,
                self._in_flange(moved, looks) if of_tool else in_flange,
            )
            slopes[:, :, column] = (misses - here) / STEP
        return slopes

    def _levers(self, looks: LookArrays) -> Array:
        return gravity_levers(self.kinematics.chain, looks.joints_rad)

    def _flange(self, values: Array, looks: LookArrays, levers: Array) -> Array:
        """Poses (m, 4, 4) ROBOT <- FLANGE."""
        deviations = self.deviations(values)
        return flange_poses(self.kinematics.chain, deviations, looks.joints_rad, looks.flanks, levers)

    def _in_flange(self, values: Array, looks: LookArrays) -> Array:
        """Measured points (m, 3) mm in the flange frame."""
        return self.tool(values).apply(looks.points_mm)

    def _missed(self, values: Array, looks: LookArrays, flange: Array, in_flange: Array) -> Array:
        seen = np.einsum("mij,mj->mi", flange[:, :3, :3], in_flange) + flange[:, :3, 3]
        return np.asarray(seen - values[self.size :].reshape(-1, 3)[looks.sphere])

    def rotations(self, looks: LookArrays) -> Array:
        """Nominal orientation (m, 3, 3) ROBOT <- TOOL of each measurement."""
        flange = flange_rotations(self.kinematics.chain, looks.joints_rad)
        return np.asarray(flange @ self.flange_from_tool.rotation_matrix)
