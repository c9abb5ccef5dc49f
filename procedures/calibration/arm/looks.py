"""Input of an arm calibration: stationary spheres, each measured by the stereo head from many poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.calibration.observations import Joints
from procedures.calibration.same_theatre import Measurements
from ronna_hw.calibration import (
    ArmCalibration,
    ArmName,
    Dated,
    Numbers3,
    StereoHeadCalibration,
    Strict,
    ToolTipCalibration,
)

Array = NDArray[np.float64]

LOOKS_FILE = "looks.json"
Side = Literal[-1, 1]
Flanks = tuple[Side, Side, Side, Side, Side, Side]


class SphereLook(Strict):
    """One measurement of one sphere."""

    sphere: Annotated[int, Field(ge=0)] = Field(description="Number of the sphere.")
    joints_rad: Joints = Field(description="Measured joints, from the base outwards.")
    flanks: Flanks = Field(description="Direction from which each joint arrived.")
    point_mm: Numbers3 = Field(description="The sphere in the tool frame of the record in use.")
    covariance_mm2: tuple[Numbers3, Numbers3, Numbers3] = Field(description="Covariance of that point.")
    validation: bool = Field(description="Held out from the identification, for validation.")


class ArmLooks(Measurements):
    """All measurements of one calibration, and the records in use."""

    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of the file format.")
    arm: ArmName = Field(description="Name of the arm's kinematic model.")
    arm_serial: str = Field(default="", description="Its serial number, if its controller reports one.")
    serials: tuple[str, str] = Field(description="Serial numbers of the left and the right camera.")
    stereo_head: StereoHeadCalibration = Field(description="The record of the head in use.")
    tool_tip: ToolTipCalibration | None = Field(default=None, description="The tip record in use.")
    arm_record: ArmCalibration | None = Field(default=None, description="The record of the arm in use.")
    looks: tuple[SphereLook, ...] = Field(description="The measurements.")

    @property
    def records(self) -> Mapping[str, Dated | None]:
        """As `Measurements.records`."""
        return {"stereo_head": self.stereo_head, "tool_tip": self.tool_tip}


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

    def only(self, rows: NDArray[np.bool_]) -> LookArrays:
        """Selected measurements, with the same sphere numbers."""
        return LookArrays(*(getattr(self, field.name)[rows] for field in fields(self)))


def arrays_of(looks: Sequence[SphereLook]) -> LookArrays:
    """The measurements as arrays; spheres that were never seen leave no gap in the numbering."""
    _, sphere = np.unique([one.sphere for one in looks], return_inverse=True)
    return LookArrays(
        joints_rad=np.array([one.joints_rad for one in looks]),
        flanks=np.array([one.flanks for one in looks], dtype=float),
        points_mm=np.array([one.point_mm for one in looks]),
        covariances_mm2=np.array([one.covariance_mm2 for one in looks]),
        sphere=np.asarray(sphere, dtype=np.intp),
    )
