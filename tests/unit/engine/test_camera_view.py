"""The viewing pyramids of the stereo head's cameras."""

from __future__ import annotations

import numpy as np
from recording_cell import RecordingCell

from procedures.engine.display_feed import camera_views
from procedures.relocalization.triangulation import Camera


def test_the_corners_of_a_pyramid_match_the_picture_and_it_reaches_beyond_the_tool(
    cell: RecordingCell,
) -> None:
    head = cell.calibrations.stereo_head
    for view, camera in zip(camera_views(head), (head.left, head.right), strict=True):
        centre, *corners = np.reshape(view.points_mm, (-1, 3))
        columns, rows = camera.sensor_px
        undistorted = camera.model_copy(update={"distortion": (0.0,) * 5})
        seen = np.array([Camera(undistorted).project(corner)[0] for corner in corners])
        assert np.allclose(seen, [(0, 0), (columns, 0), (columns, rows), (0, rows)], atol=15.0)  # 0.05 mm
        assert np.allclose(centre, Camera(camera).centre_mm, atol=0.06)
        middle = np.mean(corners, axis=0) - centre
        assert np.linalg.norm(middle) > np.linalg.norm(centre)  # beyond the tool's origin
