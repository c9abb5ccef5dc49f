"""Check of an arm against its calibration, with a few measurements of spheres at any positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, null_space
from scipy.special import chdtri

from procedures.calibration.arm_calibration import LEAST_VALIDATION, MODEL_SHARE
from procedures.calibration.arm_model import ArmLooks, LookArrays, arrays_of
from procedures.calibration.arm_sources import ArmPoses, arm_sources
from procedures.calibration.errors import ARM_CHANGED, NO_ARM_RECORD
from procedures.calibration.pose_set import require_count
from procedures.registration.error_theory import propagate
from procedures.registration.target_prediction import SharedErrors
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import ArmDeviations, flange_poses
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.calibration import ArmCalibration
from ronna_hw.config import ProcedureSettings
from ronna_hw.frames import Frame
from ronna_hw.text import format_distinct

FALSE_ALARM = 0.001  # one check in a thousand of an unchanged arm


@dataclass(frozen=True)
class ArmCheck:
    """Result of an arm check: 3-D rms error `error_mm`, and `expected_mm` from the record."""

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
        """Raise CAL-012 unless the measurements agree with the calibration."""
        if not self.passed:
            error, limit = format_distinct(self.error_mm, self.expected_mm, 3)
            raise ARM_CHANGED(
                f"the measurements do not match calibration {self.calibration}",
                limit=f"{limit} mm rms expected",
                got=f"{error} mm",
            )


def require_record(record: ArmCalibration | None) -> ArmCalibration:
    """Return the record; raise CAL-014 if there is none."""
    if record is None:
        raise NO_ARM_RECORD("the theatre file has no calibration record of the arm")
    return record


def check_arm(observed: ArmLooks) -> ArmCheck:
    """Compare measurements with the record in use. Raises CAL-002, CAL-014.

    The spheres' positions need not be known.
    """
    record = require_record(observed.arm_record)
    looks, kinematics = arrays_of(observed.looks), find_arm(observed.arm).kinematics
    count = len(looks.joints_rad)
    require_count(count, LEAST_VALIDATION, "too few measurements to check the arm")
    spheres = looks.spheres
    flange = flange_poses(kinematics.chain, ArmDeviations.of(record), looks.joints_rad, looks.flanks)
    tool = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    measured_mm = np.einsum("mij,mj->mi", flange[:, :3, :3], tool.apply(looks.points_mm)) + flange[:, :3, 3]
    orientations = flange[:, :3, :3] @ tool.rotation_matrix
    random_mm2 = propagate(orientations, looks.covariances_mm2) + record.scatter_mm**2 * np.eye(3)
    shared_mm = _record_displacements_mm(record, kinematics.chain, looks, measured_mm).reshape(3 * count, -1)
    # The part of the measurements beyond each sphere's mean does not depend on the spheres' positions.
    at_sphere = looks.sphere == np.arange(spheres)[:, None]
    contrasts = np.kron(null_space(at_sphere), np.eye(3))
    covariance = contrasts.T @ (block_diag(*random_mm2) + shared_mm @ shared_mm.T) @ contrasts
    deviations_mm = contrasts.T @ measured_mm.ravel()
    return ArmCheck(
        calibration=record.identifier,
        looks=count,
        error_mm=float(np.sqrt(deviations_mm @ deviations_mm / count)),
        expected_mm=float(np.sqrt(np.trace(covariance) / count)),
        statistic=float(deviations_mm @ np.linalg.solve(covariance, deviations_mm)),
        limit=float(chdtri(len(deviations_mm), FALSE_ALARM)) * (1.0 + MODEL_SHARE),
    )


def _record_displacements_mm(
    record: ArmCalibration, chain: Chain, looks: LookArrays, places_mm: Array
) -> Array:
    """Return displacements (m, 3, k) of measured positions due to the record's k independent errors.

    They are equal in all measurements: a link that is too long stays too long.
    """
    sizes = ErrorSizes.stated(ProcedureSettings(), record)
    spheres, last = (
        ArmPoses(looks.joints_rad[rows], places_mm[rows], looks.flanks[rows])
        for rows in (slice(-1), slice(-1, None))
    )
    return np.concatenate(
        [
            np.concatenate([one.at_spheres_mm, one.at_target_mm[None]])
            for one in arm_sources(chain, spheres, last, sizes)
            if isinstance(one, SharedErrors)
        ],
        axis=2,
    )
