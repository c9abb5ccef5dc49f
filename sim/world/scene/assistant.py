"""The assistant of a theatre: where its cart stands, its true arm, and what its holder carries.

Its cart stands beside the patient, opposite the tracker. Everything is drawn with noise of its own, so the
rest of the scene stays as it is.
"""

from __future__ import annotations

from math import radians

import numpy as np

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.calibration import PoseRecord
from sim.errors import BAD_SCENE
from sim.world.descriptions import DESCRIPTIONS
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import as_point, matrix_from, pose_of, rotation_from_vector, rotation_towards
from sim.world.scene.arm_design import CHOSEN, DESIGNS
from sim.world.scene.as_built import draw_arm
from sim.world.scene.model import AssistantTruth, ForceSensorTruth, Scene, TrackerTool
from sim.world.scene.parts import (
    ASSISTANT_FRAME_MARKERS_MM,
    ASSISTANT_FRAME_NAME,
    ASSISTANT_FRAME_PART_NUMBER,
)

# From the middle of the places of the head, on the floor; it faces the patient, who is as high for its own
# base as for that of a master of its model.
CART_FROM_HEAD_MM, CART_TURN_DEG = (-130.0, -700.0), 90.0
PARKED_MM, PARKED_DEG, FLOOR_DEG = 25.0, 3.0, 0.3  # by hand, on a floor that is not quite level; one sigma
# Beside the flange, away from the instrument; it faces back along that, so that a tracker above sees it at
# whatever turn the instrument is led into the guide.
FRAME_MM = (-90.0, 90.0, -20.0)
FRAME_TURN = rotation_towards((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0))
BALL_MM = (0.0, 0.0, 160.0)  # at the end of the holder's post
# The post also carries the clamp, across: the instrument points along the flange's x axis.
CLAMP_MM, CLAMP_TURN_DEG = (0.0, 0.0, 110.0), 90.0  # about y
BUILT_MM, BUILT_DEG = 1.0, 0.5  # frame, post and clamp against their drawing; one sigma
CLAMP = "clamp of the assistant"  # noise key
# Two standard errors of a change of the force that an arm estimates by itself: for the e-Series the precision
# of its data sheets (U: quoted from memory). Against another sensor a UR5e had means of 8.95 to 13.26 N for
# 10 N (Trochimczuk et al., Sensors 26:1709, 2026). CB3 estimates by currents: 10 N (vendor's forum).
FORCE_ERROR_N = {"ur5": 10.0, "ur3e": 2.0, "ur5e": 3.5, "ur10e": 5.0, "ur16e": 5.0}


def add_assistant(scene: Scene, arm: ArmChoice = ArmChoice.KR6) -> Scene:
    """Return the scene with an assistant of a model; raises SIM-001 without a patient."""
    if not scene.tracker.fiducials_visible:
        raise BAD_SCENE(f"{scene.name} has no patient for two arms")
    if scene.assistant is not None:
        return scene
    draws = noise(scene.seed, ArmRole.ASSISTANT.value, 1)
    on_floor = rotation_from_vector((*np.radians(draws.normal(0.0, FLOOR_DEG, 2)), 0.0))
    turned = rotation_from_vector((0.0, 0.0, radians(CART_TURN_DEG + draws.normal(0.0, PARKED_DEG))))
    design = CHOSEN[arm]
    x_mm, y_mm, z_mm = DESIGNS[scene.arm.variant].head_mm
    beside_mm = (x_mm + CART_FROM_HEAD_MM[0], y_mm + CART_FROM_HEAD_MM[1], z_mm - design.head_mm[2])
    place_mm = np.array(beside_mm) + draws.normal(0.0, PARKED_MM, 3) * (1.0, 1.0, 0.2)
    frame_turn = rotation_from_vector(np.radians(draws.normal(0.0, BUILT_DEG, 3)))
    clamp = noise(scene.seed, CLAMP, 0).normal(0.0, BUILT_DEG, 3)
    clamp_turn = rotation_from_vector((0.0, radians(CLAMP_TURN_DEG), 0.0)) @ rotation_from_vector(
        np.radians(clamp)
    )
    true_arm = draw_arm(draws, design).model_copy(update={"home_deg": design.assistant_home_deg})
    assistant = AssistantTruth(
        robot_from_base=pose_of(matrix_from(place_mm, on_floor @ turned)),
        arm=true_arm,
        flange_from_frame=_built(FRAME_MM, FRAME_TURN @ frame_turn, draws),
        flange_from_ball_mm=as_point(np.array(BALL_MM) + draws.normal(0.0, BUILT_MM, 3)),
        flange_from_clamp=_built(CLAMP_MM, clamp_turn, draws),
        force_error_N=FORCE_ERROR_N.get(true_arm.variant),
        force_sensor=None if DESCRIPTIONS[true_arm.variant].make.senses_force else ForceSensorTruth(),
    )
    tools = tuple(one for one in scene.tracker.tools if one.part_number != ASSISTANT_FRAME_PART_NUMBER)
    tracker = scene.tracker.model_copy(update={"tools": (*tools, frame_on_assistant())})
    return scene.model_copy(update={"assistant": assistant, "tracker": tracker})


def frame_on_assistant() -> TrackerTool:
    """Return the assistant's frame as a tracker tool."""
    return TrackerTool(
        name=ASSISTANT_FRAME_NAME,
        part_number=ASSISTANT_FRAME_PART_NUMBER,
        markers_mm=ASSISTANT_FRAME_MARKERS_MM,
    )


def _built(place_mm: tuple[float, float, float], turn: np.ndarray, draws: np.random.Generator) -> PoseRecord:
    return pose_of(matrix_from(np.array(place_mm) + draws.normal(0.0, BUILT_MM, 3), turn))
