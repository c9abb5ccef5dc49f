"""Scenes for calibration: an arm without geometric errors, and a camera that has turned in its mount."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.theatre.rigid import matrix_from, matrix_of, pose_of, rotation_from_vector
from sim.theatre.scene.model import LinkError, Scene
from sim.theatre.scene.named_scenes import named_scene

STRAIGHT = LinkError(translation_mm=(0.0, 0.0, 0.0), rotation_rad=(0.0, 0.0, 0.0))
NOUGHT = (0.0,) * 6


def with_ideal_arm(seed: int = 0) -> Scene:
    """The mini scene with an arm that only repeats badly: 0.015 mm per axis."""
    scene = named_scene("mini", seed=seed)
    arm = scene.arm.model_copy(
        update={
            "links": (STRAIGHT,) * 6,
            "joint_offset_rad": NOUGHT,
            "harmonic_1_rad": NOUGHT,
            "harmonic_2_rad": NOUGHT,
            "sag_rad": (0.0, 0.0),
            "backlash_rad": NOUGHT,
        }
    )
    return scene.model_copy(update={"arm": arm})


def with_turned_camera(scene: Scene, degrees: float) -> Scene:
    """The same with the left camera turned in its mount, about its own columns."""
    turn = matrix_from(np.zeros(3), rotation_from_vector((0.0, float(np.radians(degrees)), 0.0)))
    pose = pose_of(turn @ matrix_of(scene.left.camera_from_tool))
    return scene.model_copy(update={"left": scene.left.model_copy(update={"camera_from_tool": pose})})


def write_scene(scene: Scene, path: Path) -> Path:
    """As a scene file."""
    path.write_text(scene.model_dump_json(by_alias=True))
    return path
