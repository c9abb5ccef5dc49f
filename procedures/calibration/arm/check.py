"""Checks an arm against its calibration with a few measurements of spheres, wherever they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from procedures.calibration.arm.identification import whitening_of
from procedures.calibration.arm.looks import ArmLooks, arrays_of
from procedures.calibration.arm.validation import LEAST_VALIDATION, MODEL_SHARE
from procedures.calibration.errors import ArmChanged, NoArmRecord
from procedures.calibration.sufficiency import require_count
from ronna_hw.arm.catalogue import kinematics_named
from ronna_hw.arm.deviations import ArmDeviations, flange_poses
from ronna_hw.calibration import ArmCalibration
from ronna_hw.frames import Frame
from ronna_hw.text.beyond import told_apart

FALSE_ALARM = 0.001  # one check in a thousand of an unchanged arm


@dataclass(frozen=True)
class ArmCheck:
    """`error_mm` is the 3-D rms error, `expected_mm` the value expected from the record."""

    calibration: str
    looks: int
    error_mm: float
    expected_mm: float
    statistic: float
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the measurements agree with the calibration."""
        return self.statistic <= self.limit

    def require(self) -> None:
        """Raise CAL-012 unless they do."""
        if not self.passed:
            error, limit = told_apart(self.error_mm, self.expected_mm, 3)
            raise ArmChanged(
                f"the measurements do not match calibration {self.calibration}",
                limit=f"{limit} mm rms expected",
                got=f"{error} mm",
            )


def require_record(record: ArmCalibration | None) -> ArmCalibration:
    """The record, or CAL-014 if there is none."""
    if record is None:
        raise NoArmRecord("the theatre file has no calibration record of the arm")
    return record


def check_arm(observed: ArmLooks) -> ArmCheck:
    """Compare measurements with the record in use; each sphere's position is the mean of its measurements.

    Raises CAL-002, CAL-014.
    """
    record = require_record(observed.arm_record)
    looks, kinematics = arrays_of(observed.looks), kinematics_named(observed.arm)
    count = len(looks.joints_rad)
    require_count(count, LEAST_VALIDATION, "too few measurements to check the arm")
    spheres = looks.spheres
    flange = flange_poses(kinematics.chain, ArmDeviations.of(record), looks.joints_rad, looks.flanks)
    tool = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    seen = np.einsum("mij,mj->mi", flange[:, :3, :3], tool.apply(looks.points_mm)) + flange[:, :3, 3]
    for number in range(spheres):
        here = looks.sphere == number
        seen[here] -= seen[here].mean(axis=0)
    turned = flange[:, :3, :3] @ tool.rotation_matrix
    model_mm2 = (record.stated_error_mm**2 / 3.0 + record.scatter_mm**2) * np.eye(3)
    covariances = turned @ looks.covariances_mm2 @ turned.transpose(0, 2, 1) + model_mm2
    whitened = np.einsum("mij,mj->mi", whitening_of(covariances, 0.0), seen)
    return ArmCheck(
        calibration=record.identifier,
        looks=count,
        error_mm=float(np.sqrt(np.mean(np.sum(seen**2, axis=1)))),
        expected_mm=float(np.sqrt(np.mean(np.einsum("mii->m", covariances)))),
        statistic=float(np.sum(whitened**2)),
        limit=float(chdtri(3 * (count - spheres), FALSE_ALARM)) * (1.0 + MODEL_SHARE),
    )
