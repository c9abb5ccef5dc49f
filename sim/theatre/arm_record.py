"""The calibration record of an arm as a laboratory would have it: the truth plus residual errors."""

from __future__ import annotations

from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronna_hw.calibration import PoseRecord
from sim.world.nominal_arm import FLANGE_PITCH_DEG
from sim.world.rigid import matrix_from, matrix_of, pose_of, rotation_from_vector
from sim.world.scene.model import ArmResidual, ArmTruth, Mount

Array = NDArray[np.float64]
# 3-D error of one point among others with such a record: residuals through the chain, on 200 random arms.
STATED_ERROR_MM = 0.10
# Effect of such an arm on the points of one head, all approached alike, per axis: its links and offsets
# retain 15 and 16 % of an uncalibrated arm's errors, whose effect is 0.10 mm.
ARM_ERROR_MM = 0.016


def arm_values(truth: ArmTruth, residual: ArmResidual, generator: np.random.Generator) -> dict[str, Any]:
    """The deviations of the record, named as in `ronna_hw.calibration.ArmCalibration`."""

    def off(values: Any, sigma: float) -> Array:
        exact = np.asarray(values, dtype=float)
        return exact + generator.normal(0.0, sigma, exact.shape)

    # The scene expresses the error of the last link in the flange frame, the record in the one before.
    flange = rotation_from_vector((0.0, radians(FLANGE_PITCH_DEG), 0.0))
    translations = np.array([link.translation_mm for link in truth.links])
    rotations = np.array([link.rotation_rad for link in truth.links])
    translations[-1], rotations[-1] = flange @ translations[-1], flange @ rotations[-1]
    amplitudes = np.stack([truth.harmonic_1_rad, truth.harmonic_2_rad], axis=1)
    phases = np.stack([truth.harmonic_1_phase_rad, truth.harmonic_2_phase_rad], axis=1)
    values = {
        "link_translation_mm": off(translations, residual.link_mm),
        "link_rotation_rad": off(rotations, residual.angle_rad),
        "joint_offset_rad": off(truth.joint_offset_rad, residual.angle_rad),
        "sine_rad": amplitudes * np.vectorize(cos)(phases),
        "cosine_rad": amplitudes * np.vectorize(sin)(phases),
        "sag_rad": np.array([0.0, *truth.sag_rad, 0.0, 0.0, 0.0]),
        "backlash_rad": np.array(truth.backlash_rad),
    }
    return {name: array.tolist() for name, array in values.items()}


def measured_mount(mount: Mount, residual: ArmResidual, generator: np.random.Generator) -> PoseRecord:
    """FLANGE <- TOOL of the head as found by a calibration, instead of the nominal one."""
    beside = matrix_from(generator.normal(0.0, residual.tool_mm, 3), np.eye(3))
    return pose_of(matrix_of(mount.flange_from_tool_true) @ beside)
