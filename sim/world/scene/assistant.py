"""The assistant of a theatre: where its cart stands, its true arm, and what its holder carries.

Its cart stands beside the patient, opposite the tracker. Everything is drawn with noise of its own, so the
rest of the scene stays as it is.
"""

from __future__ import annotations

from math import radians

import numpy as np

from ronna_hw.calibration import PoseRecord
from sim.errors import BadScene
from sim.world.noise import noise
from sim.world.options import ArmRole
from sim.world.rigid import as_point, matrix_from, pose_of, rotation_from_vector, rotation_towards
from sim.world.scene.as_built import draw_arm
from sim.world.scene.model import AssistantTruth, Scene, TrackerTool
from sim.world.scene.parts import (
    ASSISTANT_FRAME_MARKERS_MM,
    ASSISTANT_FRAME_NAME,
    ASSISTANT_FRAME_PART_NUMBER,
)

CART_MM, CART_TURN_DEG = (620.0, -830.0, 0.0), 90.0  # it faces the patient
PARKED_MM, PARKED_DEG, FLOOR_DEG = 25.0, 3.0, 0.3  # by hand, on a floor that is not quite level; one sigma
# Behind the flange, on the side away from the holder; it faces back along the flange's axis.
FRAME_MM = (70.0, 0.0, -80.0)
BALL_MM = (0.0, 0.0, 160.0)  # at the end of the holder's post
BUILT_MM, BUILT_DEG = 1.0, 0.5  # frame and post against their drawing; one sigma
# The flange down, drawn back from the patient.
HOME_DEG = (0.0, -110.0, 130.0, 0.0, 70.0, 0.0)


def add_assistant(scene: Scene) -> Scene:
    """Return the scene with an assistant; raises SIM-001 without a patient."""
    if not scene.tracker.fiducials_visible:
        raise BadScene(f"{scene.name} has no patient for two arms")
    if scene.assistant is not None:
        return scene
    draws = noise(scene.seed, ArmRole.ASSISTANT.value, 1)
    on_floor = rotation_from_vector((*np.radians(draws.normal(0.0, FLOOR_DEG, 2)), 0.0))
    turned = rotation_from_vector((0.0, 0.0, radians(CART_TURN_DEG + draws.normal(0.0, PARKED_DEG))))
    place_mm = np.array(CART_MM) + draws.normal(0.0, PARKED_MM, 3) * (1.0, 1.0, 0.2)
    facing = rotation_towards((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
    frame_turn = rotation_from_vector(np.radians(draws.normal(0.0, BUILT_DEG, 3)))
    arm = draw_arm(draws).model_copy(update={"home_deg": HOME_DEG})
    assistant = AssistantTruth(
        robot_from_base=pose_of(matrix_from(place_mm, on_floor @ turned)),
        arm=arm,
        flange_from_frame=_built(FRAME_MM, facing @ frame_turn, draws),
        flange_from_ball_mm=as_point(np.array(BALL_MM) + draws.normal(0.0, BUILT_MM, 3)),
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
