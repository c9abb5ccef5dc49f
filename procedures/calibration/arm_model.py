"""Model of arm and stereo head for an arm calibration, its measurements, and the choice of poses.

The model's vector consists of the arm's deviations, six parameters of the head on the flange, and three
coordinates per sphere. Deviations and head are in units of their prior standard deviation for an uncalibrated
arm, so that a covariance of 1 means that nothing was learnt. Spheres are in millimetres, without a prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.calibration.observations import Measurements
from procedures.registration.error_theory import propagate
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arrays import Array, Mask
from ronna_hw.calibrated_arm.deviations import ArmDeviations, flange_poses, flange_rotations, gravity_levers
from ronna_hw.calibrated_arm.error_budget import (
    BACKLASH_RAD,
    HARMONIC_RAD,
    JOINT_OFFSET_RAD,
    LINK_ROTATION_RAD,
    LINK_TRANSLATION_MM,
    SAG_RAD,
    TOOL_MM,
)
from ronna_hw.calibration import (
    ArmCalibration,
    ArmName,
    Numbers3,
    StereoHeadCalibration,
    Strict,
    ToolTipCalibration,
)
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

LOOKS_FILE = "looks.json"
Side = Literal[-1, 1]
Flanks = tuple[Side, ...]

TOOL_RAD = math.radians(0.5)  # a machined mount
TOOL = 6
BACKLASH = "backlash"  # part of a parameter's name
STEP = 1e-3  # of a numerical derivative: in units of a prior, or mm

LOOK_SIGMA_MM = 0.02  # of a measurement, per axis: repeatability of a good arm, and the stereo head
SPHERE_SIGMA_MM = 10.0  # prior uncertainty of a sphere's position


class SphereLook(Strict):
    """One measurement of a sphere."""

    sphere: Annotated[int, Field(ge=0)] = Field(description="Number of the sphere.")
    joints_rad: JointVector = Field(description="Measured joints, from the base outwards.")
    flanks: Flanks = Field(description="Direction from which each joint arrived.")
    point_mm: Numbers3 = Field(description="The sphere in the tool frame of the record in use.")
    covariance_mm2: tuple[Numbers3, Numbers3, Numbers3] = Field(description="Covariance of that point.")
    validation: bool = Field(description="Held out from the identification, for validation.")


class ArmLooks(Measurements):
    """All measurements for one arm calibration, and the records in use."""

    RECORDS: ClassVar = {"stereo_head": "stereo_head", "tool_tip": "tool_tip"}

    arm: ArmName = Field(description="Name of the arm's kinematic model.")
    arm_serial: str = Field(default="", description="Its serial number, if its controller reports one.")
    serials: tuple[str, str] = Field(description="Serial numbers of the left and the right camera.")
    stereo_head: StereoHeadCalibration = Field(description="The record of the head in use.")
    tool_tip: ToolTipCalibration | None = Field(default=None, description="The tip record in use.")
    arm_record: ArmCalibration | None = Field(default=None, description="The record of the arm in use.")
    looks: tuple[SphereLook, ...] = Field(description="The measurements.")


@dataclass(frozen=True)
class LookArrays:
    """Measurements as arrays of m rows; `sphere` numbers the spheres from 0 without gaps."""

    joints_rad: Array  # (m, n)
    flanks: Array  # (m, n)
    points_mm: Array  # (m, 3) tool frame
    covariances_mm2: Array  # (m, 3, 3) tool frame
    sphere: NDArray[np.intp]  # (m,)

    @property
    def spheres(self) -> int:
        """Number of spheres."""
        return int(self.sphere.max()) + 1

    def only(self, rows: Mask) -> LookArrays:
        """Select measurements; the sphere numbers are unchanged."""
        return LookArrays(*(getattr(self, field.name)[rows] for field in fields(self)))


def arrays_of(looks: Sequence[SphereLook]) -> LookArrays:
    """Convert measurements to arrays, renumbering the spheres without gaps."""
    _, sphere = np.unique([one.sphere for one in looks], return_inverse=True)
    return LookArrays(
        joints_rad=np.array([one.joints_rad for one in looks]),
        flanks=np.array([one.flanks for one in looks], dtype=float),
        points_mm=np.array([one.point_mm for one in looks]),
        covariances_mm2=np.array([one.covariance_mm2 for one in looks]),
        sphere=np.asarray(sphere, dtype=np.intp),
    )


@dataclass(frozen=True)
class ArmModel:
    """Model of arm and head: nominal values and possible deviations."""

    kinematics: Kinematics
    flange_from_tool: Transform

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.kinematics.axis_names)

    @cached_property
    def prior(self) -> Array:
        """Prior standard deviation of each deviation, in vector order; 0 for those not estimated."""
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
        """Length of the parameter vector, excluding the spheres."""
        return int(np.count_nonzero(self.prior)) + TOOL

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in vector order, excluding the spheres."""
        axes = self.kinematics.axis_names
        labels = [f"link {axis} {way}" for axis in axes for way in ("x", "y", "z")]
        labels += [f"link {axis} turn {way}" for axis in axes for way in ("x", "y", "z")]
        labels += [f"{axis} offset" for axis in axes]
        for harmonic in ("sine", "cosine"):
            labels += [f"{axis} {harmonic} {order}" for axis in axes for order in ("once", "twice")]
        labels += [f"{axis} sag" for axis in axes] + [f"{axis} {BACKLASH}" for axis in axes]
        free = [name for name, sigma in zip(labels, self.prior, strict=True) if sigma > 0.0]
        return (*free, *(f"head {way}" for way in ("x", "y", "z", "turn x", "turn y", "turn z")))

    def deviations(self, values: Array) -> ArmDeviations:
        """Extract the arm's deviations from a parameter vector."""
        prior = self.prior
        row = np.zeros(len(prior))
        row[prior > 0.0] = values[: self.size - TOOL]
        return ArmDeviations.from_flat(row * prior, self.joints)

    def tool(self, values: Array) -> Transform:
        """Extract the pose FLANGE <- TOOL from a parameter vector."""
        head = values[self.size - TOOL : self.size]
        change = RigidTransform.from_components(TOOL_MM * head[:3], Rotation.from_rotvec(TOOL_RAD * head[3:]))
        return Transform(Frame.FLANGE, Frame.TOOL, self.flange_from_tool.rigid * change)

    @property
    def to_record(self) -> Array:
        """Return the Jacobian (k, size) of a record's contents for the parameters other than the spheres.

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
        """Return the deviation of each measurement from its sphere's position, (m, 3) mm, robot frame."""
        flange = self._flange(values, looks, self._levers(looks))
        return self._compute_misses(values, looks, flange, self._flange_points(values, looks))

    def slopes(self, values: Array, looks: LookArrays) -> Array:
        """Differentiate the misses numerically, (m, 3, n); they are nearly linear in the parameters."""
        levers = self._levers(looks)
        flange, flange_points = self._flange(values, looks, levers), self._flange_points(values, looks)
        here = self._compute_misses(values, looks, flange, flange_points)
        slopes = np.empty((*here.shape, len(values)))
        for column in range(len(values)):
            perturbed = values.copy()
            perturbed[column] += STEP
            of_arm = column < self.size - TOOL
            of_tool = not of_arm and column < self.size
            misses = self._compute_misses(
                perturbed,
                looks,
                self._flange(perturbed, looks, levers) if of_arm else flange,
                self._flange_points(perturbed, looks) if of_tool else flange_points,
            )
            slopes[:, :, column] = (misses - here) / STEP
        return slopes

    def _levers(self, looks: LookArrays) -> Array:
        return gravity_levers(self.kinematics.chain, looks.joints_rad)

    def _flange(self, values: Array, looks: LookArrays, levers: Array) -> Array:
        """Return the flange poses ROBOT <- FLANGE, (m, 4, 4)."""
        deviations = self.deviations(values)
        return flange_poses(self.kinematics.chain, deviations, looks.joints_rad, looks.flanks, levers)

    def _flange_points(self, values: Array, looks: LookArrays) -> Array:
        """Return the measured points (m, 3) in the flange frame, mm."""
        return self.tool(values).apply(looks.points_mm)

    def _compute_misses(self, values: Array, looks: LookArrays, flange: Array, flange_points: Array) -> Array:
        places = np.einsum("mij,mj->mi", flange[:, :3, :3], flange_points) + flange[:, :3, 3]
        return np.asarray(places - values[self.size :].reshape(-1, 3)[looks.sphere])

    def rotations(self, looks: LookArrays) -> Array:
        """Return the nominal orientation (m, 3, 3) ROBOT <- TOOL of each measurement."""
        flange = flange_rotations(self.kinematics.chain, looks.joints_rad)
        return np.asarray(flange @ self.flange_from_tool.rotation_matrix)


def choose_poses(model: ArmModel, candidates: LookArrays, count: int) -> NDArray[np.intp]:
    """Return the indices of up to `count` of the most informative poses, by greedy D-optimal design.

    The next pose is the one that adds most to the present information, initially the prior of an uncalibrated
    arm.
    """
    values = np.zeros(model.size + 3 * candidates.spheres)
    slopes = model.slopes(values, candidates) / LOOK_SIGMA_MM
    known = np.ones(len(values))
    known[model.size :] = SPHERE_SIGMA_MM**2
    covariance: Array = np.diag(known)
    available = np.ones(len(slopes), dtype=bool)
    chosen = []
    for _ in range(min(count, len(slopes))):
        spread = propagate(slopes, covariance)
        gain = np.linalg.det(np.eye(3) + spread)
        best = int(np.argmax(np.where(available, gain, 0.0)))
        available[best] = False
        chosen.append(best)
        through = covariance @ slopes[best].T
        covariance = covariance - through @ np.linalg.solve(np.eye(3) + spread[best], through.T)
    return np.array(chosen, dtype=np.intp)
