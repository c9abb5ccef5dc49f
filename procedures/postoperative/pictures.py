"""An image per trajectory: the postoperative CT in a plane through the planned trajectory."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import RigidTransform

from procedures.imaging.volume import Volume
from procedures.postoperative.summary import FoundTrajectory
from procedures.postoperative.way import Way

Array = NDArray[np.float64]

STEP_MM = 0.25
HALF_WIDTH_MM = 15.0
BEFORE_MM, BEHIND_MM = 25.0, 12.0
WINDOW_HU = (-200.0, 1800.0)
PLANNED_COLOUR, FOUND_COLOUR = "#58c4dd", "#ff9d5c"


def trajectory_picture(post: Volume, found: FoundTrajectory, post_from_pre: RigidTransform) -> bytes:
    """One PNG: the planned trajectory runs down the middle, with the object found drawn over it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    way = Way(np.array(found.planned_entry_mm), np.array(found.planned_target_mm))
    end = np.array(found.axis_at_target_mm)
    local = way.to_local_mm(np.array([found.entry_mm, end]))
    across = _largest_offset(local)
    along = np.arange(-BEFORE_MM, way.length_mm + BEHIND_MM, STEP_MM)
    side = np.arange(-HALF_WIDTH_MM, HALF_WIDTH_MM, STEP_MM)
    grid = along[:, None, None] * np.array([1.0, 0.0, 0.0]) + side[:, None] * across
    places = post_from_pre.apply(way.to_patient_mm(grid).reshape(-1, 3))
    index = post.geometry.to_index(places).T
    values = ndimage.map_coordinates(post.voxels, index, output=np.float32, order=1, cval=-1000)
    figure = Figure(figsize=(3.2, 6.4), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.18, 0.08, 0.8, 0.85))
    extent = (side[0], side[-1], along[-1], along[0])
    axes.imshow(
        values.reshape(len(along), len(side)),
        cmap="gray",
        vmin=WINDOW_HU[0],
        vmax=WINDOW_HU[1],
        extent=extent,
    )
    axes.plot([0.0, 0.0], [0.0, way.length_mm], color=PLANNED_COLOUR, linewidth=1.0, label="planned")
    axes.plot(local @ across, local[:, 0], color=FOUND_COLOUR, linewidth=1.0, linestyle="--", label="found")
    axes.set_xlabel("across mm", fontsize=7)
    axes.set_ylabel("from the planned entry mm", fontsize=7)
    axes.tick_params(labelsize=7)
    axes.set_title(found.id, fontsize=8)
    axes.legend(fontsize=6, loc="lower right")
    picture = io.BytesIO()
    canvas.print_png(picture)
    return picture.getvalue()


def _largest_offset(local: Array) -> Array:
    """The direction (3,) across the trajectory in which the object found deviates from it."""
    off = local[int(np.argmax(np.hypot(local[:, 1], local[:, 2])))] * np.array([0.0, 1.0, 1.0])
    length = float(np.linalg.norm(off))
    return np.array([0.0, 1.0, 0.0]) if length == 0.0 else np.asarray(off / length)
