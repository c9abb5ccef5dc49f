"""Arm, mount and cameras as built: design plus random errors.

The sizes of an arm's errors belong to its design. The mount's tool error, 2 mm per axis and one standard
deviation, is that of parameter set S.

Design of the stereo head: magnification 0.25 with 50 mm lenses, so 250 mm working distance and a 45 x 24 mm
field; the optical axes intersect at the tool centre point at 55 degrees.
"""

from __future__ import annotations

from math import cos, radians, sin
from typing import Any

import numpy as np

from ronna_hw.calibration import PoseRecord
from sim.world.noise import noise
from sim.world.rigid import (
    Point,
    as_point,
    inverse,
    matrix_from,
    pose_of,
    rotation_from_vector,
    rotation_towards,
)
from sim.world.scene.arm_design import KR6, ArmDesign
from sim.world.scene.line_projector import LineProjector
from sim.world.scene.model import ArmTruth, CameraTruth, LinkError, Mount

TOOL_IN_FLANGE_MM = (220.0, 0.0, 60.0)
TOOL_ERROR_MM = 2.0  # per axis: deviation of the mount from its drawing
MARKER_IN_TOOL_MM = (-150.0, 0.0, -140.0)
HALF_ANGLE_RAD = radians(27.5)
WORKING_DISTANCE_MM = 250.0
FOCAL_PX = 62.5 / 0.0055  # image distance over pixel pitch
SENSOR_CENTRE_PX = (1023.5, 543.5)
# Design positions of the two cameras in the tool frame.
CAMERAS_IN_TOOL_MM = tuple(
    (0.0, side * WORKING_DISTANCE_MM * sin(HALF_ANGLE_RAD), -WORKING_DISTANCE_MM * cos(HALF_ANGLE_RAD))
    for side in (-1.0, 1.0)
)

PROJECTOR_BEHIND_CAMERAS_MM = 10.0

BUILD_TRANSLATION_MM = 0.3
BUILD_ROTATION_RAD = radians(0.1)
BUILD_FOCAL = 0.003
BUILD_PRINCIPAL_PX = 6.0
DISTORTION_K1 = 0.02
SERIALS = ("21904411", "21904412")


def draw_arm(generator: np.random.Generator, design: ArmDesign = KR6) -> ArmTruth:
    """Draw a true arm with the errors of its design."""
    sizes = design.errors

    def six(scale: float) -> Any:
        return tuple(float(value) for value in generator.normal(0.0, scale, 6))

    def three(scale: float) -> Point:
        return as_point(generator.normal(0.0, scale, 3))

    def phases() -> Any:
        return tuple(float(value) for value in generator.uniform(0.0, 2 * np.pi, 6))

    links: Any = tuple(
        LinkError(
            translation_mm=three(sizes.link_translation_mm), rotation_rad=three(sizes.link_rotation_rad)
        )
        for _ in range(6)
    )
    return ArmTruth(
        variant=design.variant,
        home_deg=design.home_deg,
        links=links,
        joint_offset_rad=six(sizes.joint_offset_rad),
        harmonic_1_rad=six(sizes.harmonic_1_rad),
        harmonic_1_phase_rad=phases(),
        harmonic_2_rad=six(sizes.harmonic_2_rad),
        harmonic_2_phase_rad=phases(),
        sag_rad=(sizes.sag_rad, sizes.sag_rad),
        backlash_rad=(sizes.backlash_rad,) * 6,
        repeatability_mm=sizes.repeatability_mm,
    )


def draw_mount(generator: np.random.Generator) -> Mount:
    """Draw the mount: nominal and true tool pose on the flange, guide tip and reference frame M."""
    identity = PoseRecord(translation_mm=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
    error_mm = generator.normal(0.0, TOOL_ERROR_MM, 3)
    true = matrix_from(np.array(TOOL_IN_FLANGE_MM) + error_mm, np.eye(3))
    # M faces back along the tool axis, so it faces up when the tool points down.
    marker = matrix_from(MARKER_IN_TOOL_MM, rotation_towards((0.0, 0.0, -1.0), (1.0, 0.0, 0.0)))
    return Mount(
        flange_from_tool_nominal=identity.model_copy(update={"translation_mm": TOOL_IN_FLANGE_MM}),
        flange_from_tool_true=pose_of(true),
        tool_from_tip_true=identity,
        tool_from_marker_true=pose_of(marker),
    )


def draw_cameras(generator: np.random.Generator) -> tuple[CameraTruth, CameraTruth]:
    """Draw the left and right cameras as built."""
    left = _draw_camera(generator, SERIALS[0], side=-1.0)
    right = _draw_camera(generator, SERIALS[1], side=1.0)
    return left, right


def draw_projector(seed: int) -> LineProjector:
    """Draw the line projector as built, with noise of its own: the rest of a scene stays as it is."""
    generator = noise(seed, "line projector", 0)
    height_mm = CAMERAS_IN_TOOL_MM[0][2] - PROJECTOR_BEHIND_CAMERAS_MM
    place = generator.normal((0.0, 0.0, height_mm), BUILD_TRANSLATION_MM)
    turn = rotation_from_vector(generator.normal(0.0, BUILD_ROTATION_RAD, 3))
    return LineProjector(tool_from_projector=pose_of(matrix_from(place, turn)))


def _draw_camera(generator: np.random.Generator, serial: str, side: float) -> CameraTruth:
    position = np.array(CAMERAS_IN_TOOL_MM[0 if side < 0.0 else 1])
    rotation = rotation_towards(-position, (0.0, 1.0, 0.0))
    rotation = rotation @ rotation_from_vector(generator.normal(0.0, BUILD_ROTATION_RAD, 3))
    position = position + generator.normal(0.0, BUILD_TRANSLATION_MM, 3)
    focal = FOCAL_PX * (1.0 + float(generator.normal(0.0, BUILD_FOCAL)))
    centre = np.array(SENSOR_CENTRE_PX) + generator.normal(0.0, BUILD_PRINCIPAL_PX, 2)
    k1 = float(generator.normal(0.0, DISTORTION_K1))
    return CameraTruth(
        serial=serial,
        focal_px=(focal, focal),
        principal_point_px=(float(centre[0]), float(centre[1])),
        distortion=(k1, 0.0, 0.0, 0.0, 0.0),
        camera_from_tool=pose_of(inverse(matrix_from(position, rotation))),
    )
