"""Does a planned trajectory lead from the air outside, through the skin, to a target inside the head?

Judged by the CT's HU alone. Swapped points, or points that belong elsewhere, show up here: the target is in
air, the line before the entry passes through the head, or most of the path inside is air.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.planning.errors import NotIntoHead, StandoffInsideSkin
from procedures.planning.plan.model import PlannedTrajectory

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

AIR_BELOW_HU = -300.0  # fat is about -100, foam of a headrest about -930, air -1000
TARGET_BALL_MM = 3.0  # radius in which the target's surroundings are averaged
OUTSIDE_MM = (15.0, 25.0)  # before the entry: beyond the scalp for an oblique trajectory, still near the head
SAMPLING_MM = 1.0
LEAST_SHARE = 0.5  # "mostly": of the samples
SKIN_WITHIN_MM = 40.0  # outwards from an entry planned on the bone
AIR_RUN_MM = 5.0  # that is the room outside, not a fold of the skin
SKIN_RUN_MM = 5.0  # and that is the head, not a cover on it
OFF_SKIN_MM = 10.0  # more than a coarse slice or thick hair


def way_into_head(volume: Volume, trajectory: PlannedTrajectory) -> tuple[NotIntoHead | None, str]:
    """The finding that refuses the trajectory, or None, and a warning, or ''. Both points must be in the CT.

    What is beyond the CT is unknown and refuses nothing, but if the line before the entry is entirely outside
    the CT, a warning says so, as it does of an entry out in the air.
    """
    entry, target = np.array(trajectory.entry_mm), np.array(trajectory.target_mm)
    wrong, unseen = _wrong(volume, entry, target)
    warning = f"the CT ends before the entry of trajectory {trajectory.id}: its skin was not checked"
    if not wrong:
        return None, _in_the_air(volume, trajectory) or (warning if unseen else "")
    swapped = not _wrong(volume, target, entry)[0]
    hint = "; reversed, it would fit: entry and target are probably swapped" if swapped else ""
    return NotIntoHead(f"trajectory {trajectory.id}: {', '.join(wrong)}{hint}"), ""


def _wrong(volume: Volume, entry: Array, target: Array) -> tuple[list[str], bool]:
    """Problems, and whether the line before the entry is entirely outside the CT."""
    depth_mm = float(np.linalg.norm(target - entry))
    direction = (target - entry) / depth_mm
    wrong = []
    around = float(sampled_hu(volume, target + _ball()).mean())
    if around < AIR_BELOW_HU:
        wrong.append(f"the target is in air ({around:.0f} HU)")
    before = sampled_hu(volume, entry - np.outer(_steps(*OUTSIDE_MM), direction))
    if len(before) and float(np.mean(before < AIR_BELOW_HU)) < LEAST_SHARE:
        wrong.append(
            f"the path {OUTSIDE_MM[0]:g} to {OUTSIDE_MM[1]:g} mm in front of the entry is not in air "
            f"({np.median(before):.0f} HU)"
        )
    inside = sampled_hu(volume, entry + np.outer(_steps(0.0, depth_mm), direction))
    in_air = float(np.mean(inside < AIR_BELOW_HU))
    if in_air > 1.0 - LEAST_SHARE:
        wrong.append(f"{in_air:.0%} of the path from entry to target is in air")
    return wrong, len(before) == 0


def _in_the_air(volume: Volume, trajectory: PlannedTrajectory) -> str:
    """A warning of an entry farther in front of the skin than `OFF_SKIN_MM`, or ''."""
    steps = _steps(0.0, trajectory.depth_mm)
    places = np.array(trajectory.entry_mm) + np.outer(steps, trajectory.trajectory.axis_ct)
    off_mm = _first_run_mm(steps, sampled_hu(volume, places) >= AIR_BELOW_HU, SKIN_RUN_MM)
    if off_mm is None or off_mm <= OFF_SKIN_MM:
        return ""
    return (
        f"the entry of trajectory {trajectory.id} is {off_mm:.0f} mm in front of the skin: "
        "depth and stand-off count from it"
    )


def standoff_in_skin(
    volume: Volume, trajectory: PlannedTrajectory, standoff_mm: float
) -> StandoffInsideSkin | None:
    """The finding that a guide held this far before the entry would end inside the skin, or None.

    Unknown if the CT ends before the skin does.
    """
    entry, target = np.array(trajectory.entry_mm), np.array(trajectory.target_mm)
    outwards = (entry - target) / np.linalg.norm(entry - target)
    steps = _steps(0.0, SKIN_WITHIN_MM)
    in_air = sampled_hu(volume, entry + np.outer(steps, outwards)) < AIR_BELOW_HU
    skin_mm = max(0.0, (_first_run_mm(steps, in_air, AIR_RUN_MM) or 0.0) - SAMPLING_MM)
    if standoff_mm > skin_mm:
        return None
    return StandoffInsideSkin(
        f"trajectory {trajectory.id}: the guide would be held inside the skin",
        expected=f"standoff_mm of more than {skin_mm:.0f} mm in front of the entry",
        got=f"{standoff_mm:g} mm",
    )


def sampled_hu(volume: Volume, points_mm: ArrayLike) -> Array:
    """HU of the voxels that contain these points (n, 3), LPS mm; points outside the CT are dropped."""
    index = np.rint(volume.geometry.to_index(points_mm)).astype(np.intp)
    held = np.all((index >= 0) & (index < np.array(volume.geometry.shape)), axis=1)
    return np.asarray(volume.voxels[tuple(index[held].T)], dtype=float)


def _steps(first_mm: float, last_mm: float) -> Array:
    return np.linspace(first_mm, last_mm, max(2, round((last_mm - first_mm) / SAMPLING_MM) + 1))


def _first_run_mm(steps_mm: Array, held: NDArray[np.bool_], length_mm: float) -> float | None:
    """Where it holds for the first time over this length; None if nowhere."""
    run = round(length_mm / SAMPLING_MM)
    return next((float(steps_mm[k]) for k in range(len(held) - run + 1) if held[k : k + run].all()), None)


def _ball() -> Array:
    steps = np.arange(-TARGET_BALL_MM, TARGET_BALL_MM + SAMPLING_MM / 2, SAMPLING_MM)
    offsets = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    return np.asarray(offsets[np.linalg.norm(offsets, axis=1) <= TARGET_BALL_MM])
