"""Laser lines measured in pictures by a path tracer that shares nothing with the simulated cameras.

    python -m benchmarks.stereo_head.traced_lines FOLDER [--keep JSON] [--pictures PNG]

FOLDER holds views by `benchmarks/peers/line_tracer.py`; those without light from inside are left out where it
is mixed in. Prints one row per kind of picture: error of the centre in px with its normalized square, and of
the points in mm, as they are and about their mean offset along the tool axis in each view; the depth that the
glow beside the line told, and the normalized square of the depth. `--pictures` writes a crop of each kind.

A view is linear light in parts, which are mixed here: lamps of the room, the line on the surface of the skin,
and the line scattered inside. Speckle is drawn on top: a path tracer has no waves.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from procedures.relocalization.grey_image import AreaImage, GreyImage
from procedures.relocalization.laser_line import LineImage, measure_line
from procedures.relocalization.line_points import LinePoints, triangulate_line
from ronna_hw.arrays import Array
from ronna_hw.calibration import CameraCalibration, PoseRecord, StereoHeadCalibration
from ronna_hw.errors import DataError

SIDES = ("left", "right")
FOCAL_PX, PRINCIPAL_PX = 62.5e3 / 5.5, (1023.5, 543.5)  # as in the path tracer
ELECTRONS_PER_GREY, READ_NOISE_ELECTRONS, BLACK_GREY = 46.7, 13.5, 8.0
BRIGHTEST_PERCENTILE = 99.5  # of the line, where its grey level is set
SPECKLE_PX = 0.8  # standard deviation: grains of 1.9 px at f/8 and 850 nm
CROP_PX = (160, 240)  # rows and columns of a picture


@dataclass(frozen=True)
class Skin:
    """A kind of picture: grey level of line and room, share of light from inside, contrast of speckle."""

    name: str
    line: float = 160.0
    room: float = 20.0
    inside: float = 0.0
    speckle: float = 0.0


KINDS = (
    Skin("surface"),
    Skin("surface, speckle", speckle=0.3),
    Skin("surface, strong speckle", speckle=0.6),
    Skin("surface, saturated", line=700.0, speckle=0.3),
    Skin("surface, faint before a lamp", line=30.0, room=90.0),
    Skin("a quarter from inside", inside=0.25, speckle=0.3),
    Skin("half from inside", inside=0.5, speckle=0.3),
    Skin("all from inside", inside=1.0, speckle=0.3),
)


@dataclass(frozen=True)
class Measured:
    """Lines and points of a view, with their errors."""

    pictures: list[GreyImage]
    lines: list[LineImage]
    centre_errors_px: Array
    centre_squares: Array
    points: LinePoints
    point_errors_mm: Array  # (n, 3), from the nearest place of the true line


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--keep", type=Path, metavar="JSON")
    parser.add_argument("--pictures", type=Path, metavar="PNG")
    options = parser.parse_args()
    files = sorted(options.folder.glob("*.npz"))
    rows: dict[str, dict[str, float]] = {}
    crops = []
    print(
        f"{'skin':30} {'views':>5} {'px rms':>7} {'square':>7} {'mm rms':>7} {'offset':>7} {'about it':>8}"
        f" {'glow':>6} {'square':>6}"
    )
    for kind in KINDS:
        row, views = measure_kind(files, kind)
        if not views:
            continue
        if options.pictures:
            crops.append(_crop(views[0]))
        rows[kind.name.replace(",", "").replace(" ", "_")] = row
        figures = (row[each] for each in ("centre_rms_px", "centre_normalized_square", "point_rms_mm"))
        print(
            f"{kind.name:30} {len(views):5d} "
            + " ".join(f"{each:7.3f}" for each in figures)
            + f" {row['offset_mm']:7.3f} {row['point_rms_about_offset_mm']:8.3f}"
            + f" {row['glow_mm']:6.3f} {row['depth_normalized_square']:6.2f}"
        )
    if options.keep:
        kept = {"views": [each.stem for each in files], "kinds": rows}
        options.keep.write_text(json.dumps(kept, indent=1) + "\n")
    if crops:
        cv2.imwrite(str(options.pictures), np.vstack(crops))


def measure_kind(files: list[Path], kind: Skin) -> tuple[dict[str, float], list[Measured]]:
    """Return the row of a kind, and what was measured in each view."""
    views, refused = [], 0
    for file in files:
        with np.load(file) as view:
            if kind.inside and "left_inside" not in view:
                continue
            try:
                views.append(measure_view(dict(view), kind, np.random.default_rng([int(file.stem), 77])))
            except DataError as fault:
                print(f"{file.stem}, {kind.name}: {fault}")
                refused += 1
    if not views:
        return {}, []
    centres = np.concatenate([each.centre_errors_px for each in views])
    squares = np.concatenate([each.centre_squares for each in views])
    points = np.concatenate([each.point_errors_mm for each in views])
    depth = np.concatenate([each.point_errors_mm[:, 2] for each in views])
    about = [each.point_errors_mm - [0.0, 0.0, float(each.point_errors_mm[:, 2].mean())] for each in views]
    deviations = np.concatenate([np.sqrt(each.points.covariance_mm2[:, 2, 2]) for each in views])
    row = {
        "views": len(views),
        "refused": refused,
        "centres": len(centres),
        "points": len(points),
        "centre_rms_px": _rms(centres),
        "centre_normalized_square": float(squares.mean()),
        "point_rms_mm": _rms(np.linalg.norm(points, axis=1)),
        "offset_mm": float(depth.mean()),
        "glow_mm": float(np.mean([each.points.glow_mm for each in views])),
        "depth_normalized_square": float(np.mean((depth / deviations) ** 2)),
        "point_rms_about_offset_mm": _rms(np.linalg.norm(np.concatenate(about), axis=1)),
        "point_stated_mm": _rms(
            np.sqrt(
                np.concatenate([np.trace(each.points.covariance_mm2, axis1=1, axis2=2) for each in views])
            )
        ),
        "off_plane": sum(each.points.off_plane for each in views),
    }
    return row, views


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def measure_view(view: dict[str, Any], kind: Skin, random: np.random.Generator) -> Measured:
    """Expose both cameras, measure and triangulate the line, and compare with what is true."""
    lines, pictures, errors, squares = [], [], [], []
    for side in SIDES:
        lit, dark = expose(view, side, kind, random)
        line = measure_line(lit, dark)
        true_px = view[f"{side}_line_px"]
        true_px = true_px[np.isfinite(true_px).all(axis=1)]
        true_px = true_px[np.argsort(true_px[:, 1])]
        x, y = line.centres_px.T
        error = x - np.interp(y, true_px[:, 1], true_px[:, 0])
        lines.append(line)
        pictures.append(lit.pixels)
        errors.append(error)
        squares.append((error / line.deviation_px[:, 0]) ** 2)
    points = triangulate_line(lines[0], lines[1], calibration_of(view))
    true_mm = view["line_mm"][np.isfinite(view["line_mm"]).all(axis=1)]
    _, nearest = cKDTree(true_mm).query(points.points_mm)
    off = points.points_mm - true_mm[nearest]
    return Measured(pictures, lines, np.concatenate(errors), np.concatenate(squares), points, off)


def expose(view: dict[str, Any], side: str, kind: Skin, random: np.random.Generator) -> Iterator[AreaImage]:
    """Yield the picture with the line and the one without."""
    line = _scaled(view[f"{side}_surface"])
    if kind.inside:
        line = (1.0 - kind.inside) * line + kind.inside * _scaled(view[f"{side}_inside"])
    if kind.speckle:
        waves = (cv2.GaussianBlur(random.standard_normal(line.shape), (0, 0), SPECKLE_PX) for _ in range(2))
        grain = sum(wave**2 for wave in waves)
        line = line * (1.0 + kind.speckle * (grain / grain.mean() - 1.0))
    line = line * kind.line / np.percentile(line, BRIGHTEST_PERCENTILE)
    lamps = view[f"{side}_room"].astype(float)
    room = kind.room * lamps / lamps.mean()
    x, y = (int(each) for each in view[f"{side}_offset_px"])
    for light in (room + line, room):
        electrons = light * ELECTRONS_PER_GREY
        noise = np.sqrt(electrons + READ_NOISE_ELECTRONS**2) * random.standard_normal(light.shape)
        grey = (electrons + noise) / ELECTRONS_PER_GREY + BLACK_GREY
        yield AreaImage(np.clip(np.rint(grey), 0, 255).astype(np.uint8), x, y)


def _scaled(light: Array) -> Array:
    return np.asarray(light / np.percentile(light, BRIGHTEST_PERCENTILE), dtype=float)


def calibration_of(view: dict[str, Any]) -> StereoHeadCalibration:
    """Return the true calibration of the path tracer's cameras."""
    cameras = [
        CameraCalibration(
            serial=side,
            focal_px=(FOCAL_PX, FOCAL_PX),
            principal_point_px=PRINCIPAL_PX,
            camera_from_tool=_as_record(np.linalg.inv(pose)),
        )
        for side, pose in zip(SIDES, view["tool_from_cameras"], strict=True)
    ]
    now = datetime.now(UTC)
    return StereoHeadCalibration(
        identifier="path tracer",
        created=now,
        expires=now + timedelta(days=1),
        made_by="benchmark",
        stated_error_mm=0.01,
        flange_from_tool=_as_record(np.eye(4)),
        left=cameras[0],
        right=cameras[1],
    )


def _as_record(pose: Array) -> PoseRecord:
    turn = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    x, y, z = (float(each) for each in pose[:3, 3])
    a, b, c, d = (float(each) for each in turn)
    return PoseRecord(translation_mm=(x, y, z), quaternion_wxyz=(a, b, c, d))


def _crop(measured: Measured) -> GreyImage:
    """Return the middle of both pictures side by side."""
    crops = []
    for picture in measured.pictures:
        rows, columns = picture.shape
        top, left = (rows - CROP_PX[0]) // 2, (columns - CROP_PX[1]) // 2
        crops.append(picture[top : top + CROP_PX[0], left : left + CROP_PX[1]])
    return np.asarray(np.hstack(crops), dtype=np.uint8)


if __name__ == "__main__":
    main()
