"""Theatre file: device endpoints and calibration records.

A record is the truth plus an error of the stated size, drawn from the seed, as a laboratory would have
measured it. The tool frame is the exception: its record has the nominal pose, and the mount deviates from it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ronna_hw.bounded_input import read_bounded
from ronna_hw.patient_frame import PART_NUMBER as PATIENT_FRAME_PART_NUMBER
from ronna_hw.plausible import FINEST_ON_ARM_MM
from ronna_hw.records import write_atomically
from ronna_hw.wire.polaris import PolarisModel
from ronna_hw.wire.polaris_rom import ROM_FILE_LIMIT_BYTES
from sim.theatre.arm_controllers import controller_of, device_name
from sim.theatre.records import (
    CALIBRATED_ARM_ERROR_MM,
    STATED_ERROR_MM,
    arm_values,
    draw_mount_record,
    refer_to_tip,
    tool_records,
)
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import Matrix, matrix_from, matrix_of, pose_of, rotation_from_vector
from sim.world.scene.as_built import TOOL_ERROR_MM, WORKING_DISTANCE_MM
from sim.world.scene.assistant import FRAME_MM, FRAME_TURN
from sim.world.scene.model import CalibrationError, CameraTruth, Scene
from sim.world.scene.parts import ASSISTANT_FRAME_NAME
from sim.world.true_arm import arm_seed

RECORD_LIFE = timedelta(days=30)
MADE_BY = "ronna-sim theatre"
# Effect of an arm of parameter set S on the points of one head, all approached alike. Chosen on seeds 0 to
# 19, where the targets show 0.20 mm rms; on seeds 100 to 111 they show 0.19 mm.
UNCALIBRATED_ARM_ERROR_MM = 0.10
# For a frame and a guide mounted according to their drawing and never measured, per axis.
DRAWN_FRAME_MM, DRAWN_FRAME_RAD, DRAWN_TIP_MM = 2.0, 0.01, 1.0
DRAWN_DIRECTION_RAD = 1.2e-3  # of the bore about either axis: 0.1 degrees in total
DRAWN = "drawing"
LEAST_SCATTER_MM = 0.003  # a record of an arm without any random error would not be credible
# Clamp and ball of the assistant's holder on its flange, as a laboratory measures them, per axis.
HOLDER_MM, HOLDER_RAD = 0.02, 2e-4
NO_RECORDS: Mapping[str, Any] = {}
PROJECTOR = {"camera": "left", "line": "Out1", "source": "UserOutput"}  # wired to the left camera
BANNER = "SIMULATED THEATRE"
FLANGE = "changer of the simulated arm"


def theatre_content(
    scene: Scene,
    endpoints: dict[str, Any],
    clock: str,
    tool_files: dict[str, str],
    silence_limit_s: float,
    *,
    cycle_ms: int | None = None,
    calibrated: datetime | None = None,
    parameters: Sequence[str] = (),
    records: Mapping[str, Any] = NO_RECORDS,
) -> dict[str, Any]:
    """Return the theatre file as plain data, valid for `ronna_hw.config.TheatreFile`.

    `cycle_ms` is the robot's cycle if it differs from its context's, `calibrated` the time of the records if
    not now, `parameters` the NAME=VALUE of the master's controller. `records` replace the calibrations
    drawn here.
    """
    made = calibrated or datetime.now(UTC).replace(microsecond=0)
    content: dict[str, Any] = {
        "schema": 1,
        "theatre": f"{scene.name} scene, seed {scene.seed}",
        "banner": BANNER,
        "clock": {"endpoint": clock},
        "tracker": _tracker_entry(scene, endpoints["polaris"], tool_files),
        "robot": {
            role.value: controller_of(scene.arm_of(role)).device_entry(
                scene.arm_of(role).variant,
                endpoints[device],
                silence_limit_s,
                cycle_ms,
                holder=scene.holders.get(role),
            )
            for role in ArmRole
            if (device := device_name(scene, role)) in endpoints
        },
        "stereo": {
            "driver": "basler_stereo",
            "endpoints": endpoints["basler"],
            "options": {
                "left_serial": scene.left.serial,
                "right_serial": scene.right.serial,
                **({} if scene.projector is None else {"projector": PROJECTOR}),
            },
        },
        "calibration": _make_calibrations(scene, made, tuple(parameters)) | dict(records),
        "flange": FLANGE,
        "tools": tool_records(scene, lambda name: _record_header(scene, name, made), FLANGE),
        "procedure": {
            "servo_area_px": list(scene.servo_area_px),
            "stand_mm": [float(round(value)) for value in scene.stand.ball_mm],
            "arm_error_mm": UNCALIBRATED_ARM_ERROR_MM,
            "tool_error_mm": TOOL_ERROR_MM,
            **({"assistant_drills": True} if any(one.drills for one in scene.holders.values()) else {}),
            "seating_error_mm": (seating_mm := scene.head.seating_error_mm) and _credible_mm(seating_mm),
            **(
                {}
                if scene.head.robot_from_patient_frame is None
                else {"patient_frame": _patient_frame(scene)}
            ),
        },
    }
    refer_to_tip(content)
    return content


def _tracker_entry(scene: Scene, endpoint: str, tool_files: Mapping[str, str]) -> dict[str, Any]:
    """Return the tracker's table, with tools by their markers for one behind an OpenIGTLink server."""
    if endpoint.startswith("igtl:"):
        tools = [
            {"name": tool.name, "markers_mm": [list(marker) for marker in tool.markers_mm]}
            for tool in scene.tracker.tools
        ]
        return {"driver": "openigtlink_tracker", "endpoint": endpoint, "options": {"tools": tools}}
    model = scene.tracker.model
    options = {
        "tools": [_tool_entry(name, Path(rom)) for name, rom in tool_files.items()],
        **({} if model is PolarisModel.SPECTRA else {"expected_model": model.value}),
    }
    return {"driver": "ndi_polaris", "endpoint": endpoint, "options": options}


def _tool_entry(name: str, rom: Path) -> dict[str, str]:
    """Return the entry of a tool and its definition file, including the file's hash if it exists."""
    option = {"name": name, "rom": str(rom)}
    if not rom.is_file():
        return option
    content = read_bounded(rom, ROM_FILE_LIMIT_BYTES)
    return {**option, "sha256": hashlib.sha256(content).hexdigest()}


def _patient_frame(scene: Scene) -> str:
    return next(tool.name for tool in scene.tracker.tools if tool.part_number == PATIENT_FRAME_PART_NUMBER)


def write_theatre_file(content: dict[str, Any], path: Path) -> None:
    """Write the theatre file atomically."""
    import tomli_w

    write_atomically(path, tomli_w.dumps(content).encode())


def _make_calibrations(scene: Scene, created: datetime, parameters: tuple[str, ...]) -> dict[str, Any]:
    error = scene.calibration_error
    if error.first_day:
        as_drawn = {
            "tip_mm": DRAWN_TIP_MM,
            "tip_direction_rad": DRAWN_DIRECTION_RAD,
            "marker_translation_mm": DRAWN_FRAME_MM,
            "marker_rotation_rad": DRAWN_FRAME_RAD,
        }
        error = error.model_copy(update=as_drawn)
    generator = noise(scene.seed, "calibration", 0)
    measured = error.arm and draw_mount_record(
        scene.mount, error.arm, noise(scene.seed, "arm calibration", 0)
    )
    head = matrix_of(measured or scene.mount.flange_from_tool_nominal)
    tip = head @ matrix_of(scene.mount.tool_from_tip_true)
    tilt = noise(scene.seed, "guide direction", 0).normal(0.0, error.tip_direction_rad, 2)
    tip = tip @ matrix_from(generator.normal(0.0, error.tip_mm, 3), rotation_from_vector((*tilt, 0.0)))
    marker = matrix_of(scene.mount.tool_from_marker_true) @ matrix_from(
        generator.normal(0.0, error.marker_translation_mm, 3),
        rotation_from_vector(generator.normal(0.0, error.marker_rotation_rad, 3)),
    )

    def record(name: str, stated_error_mm: float, **more: Any) -> dict[str, Any]:
        return {
            **_record_header(scene, name, created),
            "stated_error_mm": _credible_mm(stated_error_mm),
            **more,
        }

    def mounted_part_record(name: str, stated_error_mm: float, **more: Any) -> dict[str, Any]:
        """Build the record of a part on the mount, which on the first day is a drawing, not a calibration."""
        made = record(name, stated_error_mm, **more)
        if not error.first_day:
            return made
        old = {"created": created - 2 * RECORD_LIFE, "expires": created - RECORD_LIFE}
        return {**made, "identifier": f"{name}-as-drawn", "made_by": DRAWN, **old}

    return {
        "stereo_head": record(
            "stereo-head",
            float(
                np.hypot(
                    3**0.5 * error.camera_translation_mm, WORKING_DISTANCE_MM * error.camera_rotation_rad
                )
            ),
            flange_from_tool=_pose_document(head),
            left=_camera_record(scene.left, error, generator),
            right=_camera_record(scene.right, error, generator),
        ),
        "tool_tip": mounted_part_record(
            "tool-tip",
            3**0.5 * error.tip_mm,
            tool_number=scene.mount.tool_number_guide,
            flange_from_tool=_pose_document(tip),
            stated_direction_error_rad=2**0.5 * error.tip_direction_rad,
        ),
        "tracker_frame": mounted_part_record(
            "tracker-frame",
            3**0.5 * error.marker_translation_mm,
            tool=scene.tracker.tools[0].name,
            tool_from_marker=_pose_document(marker),
        ),
        **_arm_record(scene, record, parameters),
        **_holder_records(scene, record),
    }


def _credible_mm(error_mm: float) -> float:
    """Return an error that a laboratory could state, even if the scene has no errors."""
    return max(error_mm, FINEST_ON_ARM_MM)


def _record_header(scene: Scene, name: str, created: datetime) -> dict[str, Any]:
    return {
        "identifier": f"{name}-{scene.name}-{scene.seed}",
        "created": created,
        "expires": created + RECORD_LIFE,
        "made_by": MADE_BY,
    }


def _arm_record(
    scene: Scene, record: Callable[..., dict[str, Any]], parameters: tuple[str, ...]
) -> dict[str, Any]:
    if scene.calibration_error.arm is None:
        return {}
    values = _arm_values(scene, ArmRole.MASTER, noise(scene.seed, "arm calibration", 1), parameters)
    return {"arm": record("arm", STATED_ERROR_MM, **values)}


def _arm_values(
    scene: Scene, role: ArmRole, draws: np.random.Generator, parameters: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return what the calibration record of an arm says about it."""
    residual, arm = scene.calibration_error.arm, scene.arm_of(role)
    assert residual is not None
    controller = controller_of(arm)
    stated = controller.state_chain(arm, arm_seed(scene.seed, role), parameters)
    values = {
        "arm": arm.variant,
        "scatter_mm": max(arm.repeatability_mm, LEAST_SCATTER_MM),
        **arm_values(arm, residual, draws, stated),
        "arm_error_mm": CALIBRATED_ARM_ERROR_MM,
        "tool_error_mm": _credible_mm(residual.tool_mm),
    }
    if len(scene.arms) > 1:  # they may be of one model: their records must not be exchanged
        values["serial"] = controller.serial(role, parameters)
    return values


def _holder_records(scene: Scene, record: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    """Return the records of an arm that holds an instrument: itself, and its holder with frame and ball."""
    records: dict[str, Any] = {}
    for role, truth in scene.holders.items() if scene.calibration_error.arm else ():
        draws = noise(scene.seed, f"{role} calibration", 0)
        records[f"{role}_arm"] = record(f"{role}-arm", STATED_ERROR_MM, **_arm_values(scene, role, draws))
        twist = matrix_from(
            draws.normal(0.0, HOLDER_MM, 3), rotation_from_vector(draws.normal(0.0, HOLDER_RAD, 3))
        )
        ball_mm = np.array(truth.flange_from_ball_mm) + draws.normal(0.0, HOLDER_MM, 3)
        records[f"{role}_holder"] = record(
            f"{role}-holder",
            3**0.5 * HOLDER_MM,
            stated_direction_error_rad=2**0.5 * HOLDER_RAD,
            flange_from_clamp=_pose_document(matrix_of(truth.flange_from_clamp) @ twist),
            flange_from_ball_mm=[float(value) for value in ball_mm],
            flange_from_frame=_pose_document(matrix_from(FRAME_MM, FRAME_TURN)),
            frame=ASSISTANT_FRAME_NAME,
        )
    return records


def _camera_record(
    camera: CameraTruth, error: CalibrationError, generator: np.random.Generator
) -> dict[str, Any]:
    twist = matrix_from(
        generator.normal(0.0, error.camera_translation_mm, 3),
        rotation_from_vector(generator.normal(0.0, error.camera_rotation_rad, 3)),
    )
    # The error is the camera's own: a rotation in its mount shifts what it sees at the working distance.
    seen = twist @ matrix_of(camera.camera_from_tool)
    scale = 1.0 + float(generator.normal(0.0, error.focal_relative))
    return {
        "serial": camera.serial,
        "focal_px": [value * scale for value in camera.focal_px],
        "principal_point_px": list(camera.principal_point_px),
        "distortion": list(camera.distortion),
        "sensor_px": list(camera.sensor_px),
        "camera_from_tool": _pose_document(seen),
    }


def _pose_document(matrix: Matrix) -> dict[str, Any]:
    return pose_of(matrix).model_dump(mode="json")
