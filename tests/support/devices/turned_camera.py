"""Scenes for calibration: a camera that has turned in its mount, and scene files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.world.rigid import matrix_from, matrix_of, pose_of, rotation_from_vector
from sim.world.scene.model import Scene


def with_turned_camera(scene: Scene, degrees: float) -> Scene:
    """Turn the left camera in its mount, about its own columns."""
    turn = matrix_from(np.zeros(3), rotation_from_vector((0.0, float(np.radians(degrees)), 0.0)))
    pose = pose_of(turn @ matrix_of(scene.left.camera_from_tool))
    return scene.model_copy(update={"left": scene.left.model_copy(update={"camera_from_tool": pose})})


def write_scene(scene: Scene, path: Path) -> Path:
    """Write a scene as a file."""
    path.write_text(scene.model_dump_json(by_alias=True))
    return path
