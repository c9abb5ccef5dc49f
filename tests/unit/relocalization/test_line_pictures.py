"""Pictures of the line in a folder give a record of its plane and width."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from procedures.relocalization.light_plane import LineRecord
from procedures.relocalization.line_pictures import record_pictures
from procedures.relocalization.triangulation import camera_model
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.errors import DataError
from ronna_hw.frames import Frame

WIDTH_PX = 5.0
NOW = datetime(2026, 11, 30, 8, 30, tzinfo=UTC)


def draw_pictures(folder: Path, calibration: StereoHeadCalibration, depths_mm: list[float]) -> None:
    """Draw a straight line across the view at each depth, in the plane x = 0 of the tool frame."""
    rows, columns = np.arange(1088.0), np.arange(2048.0)
    for number, depth in enumerate(depths_mm):
        for side, camera in (("left", calibration.left), ("right", calibration.right)):
            model = camera_model(camera, Frame[f"CAMERA_{side.upper()}"])
            ends = np.array([model.project([0.0, y, depth])[0] for y in (-15.0, 15.0)])
            x = np.interp(rows, ends[:, 1], ends[:, 0])
            light = 20.0 + 150.0 * np.exp(-0.5 * ((columns - x[:, None]) / WIDTH_PX) ** 2)
            cv2.imwrite(str(folder / f"{number}-{side}.png"), np.rint(light).astype(np.uint8))


def test_plane_and_width_are_recorded(head: Any, tmp_path: Path) -> None:
    draw_pictures(tmp_path, head.calibration, [-5.0, 0.0, 5.0])

    record = record_pictures(tmp_path, head.calibration, NOW)

    np.testing.assert_allclose(np.abs(record.normal), [1.0, 0.0, 0.0], atol=1e-3)
    assert record.offset_mm == pytest.approx(0.0, abs=2e-3)
    assert record.rms_mm < 0.002
    kept = LineRecord.model_validate_json(record.model_dump_json())
    assert (kept.created, kept.stereo_head) == (NOW, head.calibration.identifier)
    assert kept.camera_serials == (head.calibration.left.serial, head.calibration.right.serial)
    assert record.width_mm == pytest.approx(WIDTH_PX * 250.0 / (62.5e3 / 5.5), rel=0.1)


@pytest.mark.parametrize("depths_mm", [[0.0], [0.0, 0.5]])
def test_lines_at_one_distance_do_not_tell_the_plane(
    depths_mm: list[float], head: Any, tmp_path: Path
) -> None:
    draw_pictures(tmp_path, head.calibration, depths_mm)
    with pytest.raises(DataError, match="STE-020"):
        record_pictures(tmp_path, head.calibration, NOW)


@pytest.mark.parametrize("name", ["nothing.txt", "1-left.png"])
def test_a_folder_without_pairs_of_pictures_is_refused(name: str, head: Any, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"no picture")
    with pytest.raises(DataError, match="STE-019"):
        record_pictures(tmp_path, head.calibration, NOW)
