"""Poses from which the stereo head looks at the skin: spread over it, in reach, clear of the head."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.planning.paths import solve_visit
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import ArmSetting, Reached, Visit
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.surface import Surface
from procedures.strategies.skin_looks import SKIN
from procedures.strategies.strategy import ONE_SIDE, approach_joints
from procedures.strategies.trajectory import tool_pose
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import sweep_path
from ronna_hw.arm.kinematics import Branch
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arrays import Array, Mask
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform, perpendicular_axes

# Parts that hair grows on or that lie on the headrest, where a line does not show the skin; and the jaw,
# which opens.
NOT_SCANNED = ("vault", "occiput", "neck", "jaw")
TRIED_FOR_EACH = 3  # places on the skin for each view that is asked for
TILTS_RAD = tuple(np.radians((0.0, 20.0, 40.0)))  # from the skin's normal; the line still lights it well
AZIMUTHS, ROLLS = 6, 12
MOST_SWEPT = 4  # poses at one place that are checked for clearance


def mark_scannable(skin: Surface) -> Mask:
    """Mark the places of the skin (n,) that a scan is planned for."""
    return np.asarray(~np.isin(HeadAxes.of(skin).name_parts(skin.points_mm), NOT_SCANNED))


def choose_views(
    setting: ArmSetting, branch: Branch, skin_ct_mm: Array, normals_ct: Array, count: int
) -> tuple[Reached, ...]:
    """Choose up to `count` views with the tool centre on the skin (n, 3), CT mm, spread over it.

    Each is reachable in this branch, and clear of the head on its way from home and back.
    """
    turn = setting.robot_from_ct.rotation_matrix
    places, outwards = np.asarray(setting.robot_from_ct.apply(skin_ct_mm)), normals_ct @ turn.T
    around = head_around(setting)
    found: list[Reached] = []
    for row in spread_rows(places, TRIED_FOR_EACH * count):
        if len(found) == count:
            break
        view = _find_view(setting, branch, places[row], outwards[row], around)
        if view is not None:
            found.append(view)
    return tuple(found)


def head_around(setting: ArmSetting) -> Surroundings | None:
    """Return the surroundings of the stereo head at its looks, or None without a scene."""
    if setting.scene is None:
        return None
    return setting.scene.with_stereo_head(setting.robot_from_ct, _stereo_head(setting))


def turned_about_axis(setting: ArmSetting, view: Reached) -> Iterator[Reached]:
    """Yield a view turned about the tool axis, as far as the arm reaches it in its branch."""
    visit, branch = view.visit, setting.kinematics.branch_of(view.at_rad)
    for roll in np.arange(1, ROLLS) * 2.0 * np.pi / ROLLS:
        turned = visit.pose.rotation_matrix @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
        pose = tool_pose(Rotation.from_matrix(turned), visit.pose.translation_mm)
        with suppress(LimitError):
            yield _solve(setting, branch, replace(visit, pose=pose))


def spread_rows(places_mm: Array, count: int) -> list[int]:
    """Return rows of places (n, 3), each as far as possible from those before it."""
    rows = [int(np.argmax(np.linalg.norm(places_mm - places_mm.mean(axis=0), axis=1)))]
    away = np.linalg.norm(places_mm - places_mm[rows[0]], axis=1)
    while len(rows) < min(count, len(places_mm)):
        rows.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(places_mm - places_mm[rows[-1]], axis=1))
    return rows


def _stereo_head(setting: ArmSetting) -> Transform:
    return setting.flange_from_stereo or setting.flange_from_tool


def _find_view(
    setting: ArmSetting, branch: Branch, place_mm: Array, outwards: Array, around: Surroundings | None
) -> Reached | None:
    """Find a view of a place, as little tilted and with as little turning of the joints as can be."""
    start = np.array(setting.start_rad)
    for tilt_rad in TILTS_RAD:
        reached: list[tuple[float, Reached]] = []
        for pose in _list_poses(place_mm, outwards, float(tilt_rad)):
            visit = Visit(PoseName(PoseKind.FIDUCIAL, SKIN, 0), pose, setting.approach_mm)
            try:
                one = _solve(setting, branch, visit)
            except LimitError:
                continue
            reached.append((float(np.abs(np.array(one.at_rad) - start).max()), one))
        reached.sort(key=lambda item: item[0])
        for _, one in reached[:MOST_SWEPT]:
            if around is None or is_clear(setting, one, around):
                return one
    return None


def _solve(setting: ArmSetting, branch: Branch, visit: Visit) -> Reached:
    return solve_visit(
        setting.kinematics, visit, _stereo_head(setting), branch, setting.start_rad, setting.limits
    )


def is_clear(setting: ArmSetting, reached: Reached, around: Surroundings) -> bool:
    """Return whether a view can be approached from home, and left for home, without touching anything.

    A line and a way home alone would not tell: bodies that are too close where a path begins may stay so.
    """
    arm, home_rad, approach_rad = setting.kinematics, setting.start_rad, reached.approach_rad
    onto = plan_joint_move(arm, home_rad, approach_rad, setting.limits)
    home = plan_joint_move(arm, approach_rad, approach_joints(home_rad, ONE_SIDE), setting.limits)
    return all(
        sweep_path(arm, plan, around, search_closest=False).refused is None
        for plan in (reached.line, onto, home)
    )


def _list_poses(place_mm: Array, outwards: Array, tilt_rad: float) -> Iterator[Transform]:
    across, other = perpendicular_axes(outwards)
    for azimuth in np.arange(AZIMUTHS if tilt_rad else 1) * 2.0 * np.pi / AZIMUTHS:
        aside = np.cos(azimuth) * across + np.sin(azimuth) * other
        axis = -np.cos(tilt_rad) * outwards + np.sin(tilt_rad) * aside
        x, y = perpendicular_axes(axis)
        upright = np.column_stack([x, y, axis])
        for roll in np.arange(ROLLS) * 2.0 * np.pi / ROLLS:
            yield tool_pose(Rotation.from_matrix(upright) * Rotation.from_rotvec([0.0, 0.0, roll]), place_mm)
