"""What the cameras of the stereo head see, as one pyramid each, for drawing."""

from __future__ import annotations

import numpy as np

from procedures.engine.events import CameraView
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.frames import Frame

BEYOND = 1.15  # times the distance of the tool's origin, where both cameras look, so that it lies inside
DECIMALS = 1  # of a millimetre


def camera_views(head: StereoHeadCalibration) -> tuple[CameraView, ...]:
    """Centre and corners of each camera's picture, mm in the frame of the tool, without distortion."""
    return (_view("left", head.left), _view("right", head.right))


def _view(name: str, camera: CameraCalibration) -> CameraView:
    tool_from_camera = camera.camera_from_tool.transform(Frame.CAMERA_LEFT, Frame.TOOL).inverse()
    centre = tool_from_camera.translation_mm
    depth_mm = BEYOND * float(np.linalg.norm(centre))
    columns, rows = camera.sensor_px
    pixels = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], dtype=float)
    slopes = (pixels - camera.principal_point_px) / camera.focal_px
    corners = tool_from_camera.apply(depth_mm * np.column_stack([slopes, np.ones(len(slopes))]))
    points = np.vstack([centre, corners]).round(DECIMALS)
    return CameraView(name=name, points_mm=tuple(points.ravel().tolist()))
