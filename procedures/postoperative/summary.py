"""Postoperative check result for storage, output and report, with an image of each trajectory."""

from __future__ import annotations

import io
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from procedures.imaging.volume import Volume
from procedures.planning.plan_model import Plan
from procedures.postoperative.comparison import FoundTrajectory, PostoperativeComparison
from procedures.postoperative.planned_line import PlannedLine
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers4, Strict
from ronna_hw.text import format_against_limit

STEP_MM = 0.25
HALF_WIDTH_MM = 15.0
BEFORE_MM, BEHIND_MM = 25.0, 12.0
WINDOW_HU = (-200.0, 1800.0)
PLANNED_COLOUR, FOUND_COLOUR = "#58c4dd", "#ff9d5c"


class PostoperativeCheck(Strict):
    """Comparison of the postoperative CT with the plan."""

    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of this format.")
    pre_series_instance_uid: str = Field(description="The planning CT.")
    post_series_instance_uid: str = Field(description="The postoperative CT.")
    post_from_pre: tuple[Numbers4, Numbers4, Numbers4, Numbers4] = Field(
        description="Pose of the head, second CT <- first, mm."
    )
    bone_agreement: float = Field(description="Correlation of both CTs at bone; 1 for equal skulls.")
    bone_overlap: float = Field(description="Share of the first CT's bone that the second shows.")
    trajectories: tuple[FoundTrajectory, ...] = Field(description="In the order of the plan.")
    warnings: tuple[str, ...] = Field(
        default=(), description="Errors that the plan does not accept, and what limits the accuracy."
    )


def summarize_comparison(
    proof: PostoperativeComparison, plan: Plan, pre: Volume, post: Volume, warnings: tuple[str, ...] = ()
) -> PostoperativeCheck:
    """Convert a comparison to a serializable result with warnings."""
    rows = [tuple(row) for row in proof.registration.post_from_pre.as_matrix().tolist()]
    first, second, third, last = ((a, b, c, d) for a, b, c, d in rows)
    doubts = (f"{one.id} is doubtful: {doubt}" for one in proof.trajectories for doubt in one.doubts)
    return PostoperativeCheck(
        pre_series_instance_uid=pre.series_instance_uid,
        post_series_instance_uid=post.series_instance_uid,
        post_from_pre=(first, second, third, last),
        bone_agreement=proof.registration.agreement,
        bone_overlap=proof.registration.overlap,
        trajectories=proof.trajectories,
        warnings=(*_list_margin_violations(proof, plan), *pre.warnings, *post.warnings, *warnings, *doubts),
    )


def _list_margin_violations(proof: PostoperativeComparison, plan: Plan) -> tuple[str, ...]:
    sentences = []
    for one in proof.trajectories:
        margin_mm = plan.trajectory(one.id).margin_mm
        error_mm = one.lateral_mm if one.target_error_mm is None else one.target_error_mm
        if error_mm > margin_mm:
            off_mm = format_against_limit(error_mm, margin_mm, 2)
            sentences.append(f"{one.id} is {off_mm} mm off its target: the plan accepts {margin_mm:g} mm")
    return tuple(sentences)


def draw_trajectory(post: Volume, found: FoundTrajectory, post_from_pre: RigidTransform) -> bytes:
    """Draw a PNG with the planned trajectory down the middle and the found object over it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    line = PlannedLine(np.array(found.planned_entry_mm), np.array(found.planned_target_mm))
    end = np.array(found.axis_at_target_mm)
    local = line.to_local_mm(np.array([found.entry_mm, end]))
    across = _largest_offset(local)
    along = np.arange(-BEFORE_MM, line.length_mm + BEHIND_MM, STEP_MM)
    side = np.arange(-HALF_WIDTH_MM, HALF_WIDTH_MM, STEP_MM)
    grid = along[:, None, None] * np.array([1.0, 0.0, 0.0]) + side[:, None] * across
    places = post_from_pre.apply(line.to_patient_mm(grid).reshape(-1, 3))
    values = post.sample(places, -1000)
    figure = Figure(figsize=(3.2, 6.4), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.18, 0.08, 0.8, 0.85))
    extent = (side[0], side[-1], along[-1], along[0])
    low_hu, high_hu = WINDOW_HU
    axes.imshow(values.reshape(len(along), len(side)), cmap="gray", vmin=low_hu, vmax=high_hu, extent=extent)
    axes.plot([0.0, 0.0], [0.0, line.length_mm], color=PLANNED_COLOUR, linewidth=1.0, label="planned")
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
    """Return the direction (3,), perpendicular to the trajectory, in which the object deviates most."""
    off = local[int(np.argmax(np.hypot(local[:, 1], local[:, 2])))] * np.array([0.0, 1.0, 1.0])
    length = float(np.linalg.norm(off))
    return np.array([0.0, 1.0, 0.0]) if length == 0.0 else np.asarray(off / length)
