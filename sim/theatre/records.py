"""Laboratory records of the arm and tools: the truth plus residual errors."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from typing import Any

import numpy as np

from ronna_hw.calibration import PoseRecord
from ronna_hw.tool_record import GAUGE_APPROACHES, GAUGE_MOUNTINGS, TipInHead
from sim.universal_robots.stated_chain import StatedChain, deviations_from
from sim.world.descriptions import DESCRIPTIONS
from sim.world.noise import noise
from sim.world.rigid import Array, inverse, matrix_from, matrix_of, pose_of, rotation_from_vector
from sim.world.scene.model import ArmResidual, ArmTruth, Mount, Scene
from sim.world.scene.parts import CENTRE_OF_GRAVITY_MM, STEREO_HEAD_KG
from sim.world.scene.parts import GUIDE_FRAME_NAME as GUIDE_FRAME

# 3-D error of one point among others with such a record: residuals through the chain, on 200 random arms.
STATED_ERROR_MM = 0.10
# Effect of such an arm on the points of one head, all approached alike, per axis: its links and offsets
# retain 15 and 16 % of an uncalibrated arm's errors, whose effect is 0.10 mm.
CALIBRATED_ARM_ERROR_MM = 0.016

# About z from home: the gauge is on the table next to the patient.
GAUGE_TURN_DEG = 40.0
GAUGE_BASE_MM = 60.0


def arm_values(
    truth: ArmTruth, residual: ArmResidual, generator: np.random.Generator, stated: StatedChain | None = None
) -> dict[str, Any]:
    """Return the deviations for an arm record, keyed as in `ronna_hw.calibration.ArmCalibration`.

    They are those from the kinematics that the arm's driver computes with: the model's, or those that its
    controller has `stated`.
    """

    def deviate(values: Any, sigma: float) -> Array:
        exact = np.asarray(values, dtype=float)
        return exact + generator.normal(0.0, sigma, exact.shape)

    # The scene expresses the error of the last link in the flange frame, the record in the one before.
    flange = rotation_from_vector(DESCRIPTIONS[truth.variant].flange_turn_rad)
    translations = np.array([link.translation_mm for link in truth.links])
    rotations = np.array([link.rotation_rad for link in truth.links])
    translations[-1], rotations[-1] = flange @ translations[-1], flange @ rotations[-1]
    offsets = np.array(truth.joint_offset_rad)
    if stated is not None:
        arm = DESCRIPTIONS[truth.variant]
        translations, rotations = deviations_from(stated, arm, translations, rotations, offsets)
        offsets = np.zeros_like(offsets)
    amplitudes = np.stack([truth.harmonic_1_rad, truth.harmonic_2_rad], axis=1)
    phases = np.stack([truth.harmonic_1_phase_rad, truth.harmonic_2_phase_rad], axis=1)
    values = {
        "link_translation_mm": deviate(translations, residual.link_mm),
        "link_rotation_rad": deviate(rotations, residual.angle_rad),
        "joint_offset_rad": deviate(offsets, residual.angle_rad),
        "sine_rad": amplitudes * np.vectorize(cos)(phases),
        "cosine_rad": amplitudes * np.vectorize(sin)(phases),
        "sag_rad": np.array([0.0, *truth.sag_rad, 0.0, 0.0, 0.0]),
        "backlash_rad": np.array(truth.backlash_rad),
    }
    return {name: array.tolist() for name, array in values.items()}


def draw_mount_record(mount: Mount, residual: ArmResidual, generator: np.random.Generator) -> PoseRecord:
    """Draw the head's FLANGE <- TOOL as a calibration would find it."""
    beside = matrix_from(generator.normal(0.0, residual.tool_mm, 3), np.eye(3))
    return pose_of(matrix_of(mount.flange_from_tool_true) @ beside)


def tool_records(
    scene: Scene, record_header: Callable[[str], dict[str, Any]], flange: str
) -> dict[str, dict[str, Any]]:
    """Return the tool records by name, using `record_header` for the fields common to dated records."""
    mount = scene.mount
    guide = mount.guide
    first_deg, *others = scene.arm.home_deg
    gauge_deg = first_deg + GAUGE_TURN_DEG * DESCRIPTIONS[scene.arm.variant].joints[0].axis[2]
    common = {"flange": flange, "centre_of_gravity_mm": list(CENTRE_OF_GRAVITY_MM)}
    return {
        "stereo_head": {
            **record_header("tool-stereo-head"),
            **common,
            "purpose": "stereo_head",
            "number": mount.tool_number_stereo,
            "mass_kg": STEREO_HEAD_KG,
        },
        "guide": {
            **record_header("tool-guide"),
            **common,
            "purpose": "needle_guide",
            "number": mount.tool_number_guide,
            "mass_kg": guide.mass_kg,
            "bore": {"reach_mm": guide.reach_mm, "length_mm": guide.bore_mm, "play_mm": guide.play_mm},
            **_guide_frame_pose(mount),
            "gauge": {
                "joints_deg": [gauge_deg, *others],
                "base_mm": GAUGE_BASE_MM,
                **gauge_readings(scene),
            },
        },
    }


def gauge_readings(scene: Scene, mountings: int = GAUGE_MOUNTINGS) -> dict[str, Any]:
    """Draw the recorded dial readings, with seats, arrivals and noise independent of any case."""
    draws, each = noise(scene.seed, "gauge of the record", 0), GAUGE_APPROACHES // mountings
    seated = draws.normal(0.0, scene.mount.guide.seat_mm, (mountings, 1, 3))
    end = (seated + draws.normal(0.0, scene.arm.repeatability_mm, (mountings, each, 3))).reshape(-1, 3)
    read = np.hstack([end, end[:, :2]])  # the mandrel is displaced as a whole
    read += draws.normal(0.0, scene.hands.gauge_mm, read.shape)
    x, y, z, upper_x, upper_y = read.mean(axis=0).round(6).tolist()
    return {
        "reading_mm": [x, y, z],
        "upper_reading_mm": [upper_x, upper_y],
        "approaches": len(read),
        "spread_mm": round(float(np.sqrt(read.var(axis=0, ddof=1).mean())), 6),
    }


def refer_to_tip(content: dict[str, Any]) -> None:
    """Link the guide's record to the tip calibration in the same theatre file."""
    guide, records = content["tools"]["guide"], content["calibration"]
    guide["tip"] = records["tool_tip"]["identifier"]
    head, tip = (_as_pose(records[name]["flange_from_tool"]) for name in ("stereo_head", "tool_tip"))
    guide["tip_in_head"] = TipInHead.of(head, tip).model_dump(mode="json")


def _as_pose(plain: dict[str, Any]) -> PoseRecord:
    return PoseRecord.model_validate({key: tuple(value) for key, value in plain.items()})


def _guide_frame_pose(mount: Mount) -> dict[str, Any]:
    """Return the record entry for the guide's tracker frame pose on the mount, empty if it has no frame."""
    if mount.guide.tip_from_frame is None:
        return {}
    mount_from_tip = inverse(matrix_of(mount.tool_from_marker_true)) @ matrix_of(mount.tool_from_tip_true)
    pose = pose_of(mount_from_tip @ matrix_of(mount.guide.tip_from_frame))
    return {"frame": {"tool": GUIDE_FRAME, "mount_from_frame": pose.model_dump(mode="json")}}
