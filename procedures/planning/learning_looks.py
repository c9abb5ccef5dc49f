"""Choice of the looks of strategy `learning` among all poses that the arm can take over the spheres.

Candidates are the poses of `improved`, `ocs` and `jdms` at each target's free angle: the axis of a look is
named after both, such as `T1 ocs`. Only poses in reach, in sight and clear are taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.free_angle import TurnedPaths
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.motions import find_unclear
from procedures.planning.paths import solve_visit
from procedures.planning.visits import ArmSetting, PathCheck, Reached, Unmet, list_localizations
from procedures.registration.look_choice import Candidates, choose_looks
from procedures.registration.points import FEWEST_PAIRS
from procedures.strategies.catalogue import CANDIDATES
from procedures.strategies.names import DEFAULT_STRATEGY
from procedures.strategies.skin_looks import SKIN
from procedures.strategies.strategy import arrival_signs
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kinematics import Branch
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import unit_errors
from ronna_hw.errors import LimitError
from ronna_hw.vectors import JointVector

# Of a look: approach, servo and reading, besides the way there. Source: simulated cases.
LOOK_S = 4.0
WAY_RAD_S = 0.5  # of the joint that turns most, on the way to a look
# Per axis, of CT and seating: the choice hardly depends on it.
SPHERE_ERROR_MM = 0.06
LOOK_ERROR_MM = 0.03  # per axis: the arm at rest, and some of what its model lacks
CHOICES = 3  # until no chosen motion lacks clearance


def choose_learning_looks(
    setting: ArmSetting, turned: TurnedPaths, fiducials_mm: ArrayLike, sight: StereoSight
) -> TurnedPaths:
    """Replace the localizations of a passed check by the looks that teach most; others stay unchanged.

    Fiducials (n, 3) are in CT mm. At most as many looks are taken as by `ocs`. If the chosen ones cannot be
    driven, the check stays as it is, every sphere as by `ocs`, and `remark` says why.
    """
    check, fiducials = turned.check, np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    if not setting.strategy.learns_arm or not check.passed or check.branch is None or not len(fiducials):
        return turned
    if len(fiducials) < FEWEST_PAIRS:
        return replace(turned, remark=_tell_fallback(f"the choice needs {FEWEST_PAIRS} spheres", ()))
    at_skin = [one for one in check.reached if one.visit.name.trajectory == SKIN]
    axes = turned.axes.targeted
    targets = check.targets
    looks = list(_list_looks(setting, axes, targets, fiducials, check.branch, sight))
    unclear: tuple[Unmet, ...] = ()
    for _ in range(CHOICES):
        missing = set(range(len(fiducials))) - {one.visit.name.fiducial for one in looks}
        if missing:
            names = " and ".join(str(one + 1) for one in sorted(missing))
            return replace(
                turned, remark=_tell_fallback(f"no pose to choose from sees sphere {names}", unclear)
            )
        chosen = _order(setting.start_rad, _choose(setting, looks, targets, fiducials, axes))
        found = _check(setting, check, (*chosen, *at_skin, *targets), axes)
        if found.passed:
            return replace(turned, check=found)
        unclear = found.unmet
        failed = {problem.pose for problem in unclear}
        looks = [one for one in looks if one.visit.name not in failed]
    return replace(turned, remark=_tell_fallback(f"of {CHOICES} choices of looks none is clear", unclear))


def _tell_fallback(reason: str, unclear: Sequence[Unmet]) -> str:
    last = "".join(f"; {one.pose}: {one.reason}" for one in unclear[:1])
    return f"the looks of {DEFAULT_STRATEGY} are used, not chosen ones: {reason}{last}"


def target_of_look(axis: str) -> str:
    """Return the target that the axis of a look is named after."""
    return axis.rpartition(" ")[0] or axis


def look_sides(setting: ArmSetting, targets: Sequence[Reached], axes: Sequence[str]) -> list[tuple[int, ...]]:
    """Return the side from which each joint arrives at looks along these axes: that of the look's target."""
    sides = {
        one.visit.name.trajectory: arrival_signs(
            setting.kinematics, one.visit.pose, one.at_rad, setting.flange_from_tool
        )
        for one in targets
    }
    return [sides[axis] if axis in sides else sides[target_of_look(axis)] for axis in axes]


def _list_looks(
    setting: ArmSetting,
    axes: Sequence[Trajectory],
    targets: Sequence[Reached],
    fiducials_mm: Array,
    branch: Branch,
    sight: StereoSight,
) -> Iterator[Reached]:
    """Yield all looks in reach and in sight, near the joints of their target."""
    spheres_mm = setting.robot_from_ct.apply(fiducials_mm)
    stereo = setting.flange_from_stereo or setting.flange_from_tool
    for (axis, target), kind in product(zip(axes, targets, strict=True), CANDIDATES):
        named = replace(axis, identifier=f"{axis.identifier} {kind.name}")
        try:
            visits = list_localizations(replace(setting, strategy=kind), named, fiducials_mm, branch)
        except LimitError:
            continue
        hidden = {problem.pose for problem in sight.unmet(visits, spheres_mm)}
        for visit in visits:
            with suppress(LimitError):
                if visit.name not in hidden:
                    yield solve_visit(
                        setting.kinematics, visit, stereo, branch, target.at_rad, setting.limits
                    )


def _choose(
    setting: ArmSetting,
    looks: Sequence[Reached],
    targets: Sequence[Reached],
    fiducials_mm: Array,
    axes: Sequence[Trajectory],
) -> list[Reached]:
    spheres = [one.visit.name.fiducial or 0 for one in looks]
    points_mm = np.asarray(setting.robot_from_ct.apply(fiducials_mm))[spheres]
    tips_mm = np.array([setting.robot_from_ct.apply(one.target_mm) for one in axes])
    joints, at_targets = (np.array([one.at_rad for one in some]) for some in (looks, targets))
    names = [one.visit.name.trajectory for one in (*looks, *targets)]
    sides = np.array(look_sides(setting, targets, names), dtype=float)
    arm_mm = unit_errors(
        setting.kinematics.chain,
        np.concatenate([joints, at_targets]),
        np.concatenate([points_mm, tips_mm]),
        setting.sizes,
        sides,
    )
    ways_rad = np.abs(joints[:, None] - at_targets).max(axis=2).min(axis=1)
    found = choose_looks(
        Candidates(
            spheres,
            points_mm,
            LOOK_S + ways_rad / WAY_RAD_S,
            arm_mm[: len(looks)],
            np.tile(np.eye(3) * SPHERE_ERROR_MM**2, (len(fiducials_mm), 1, 1)),
            np.eye(3) * LOOK_ERROR_MM**2,
        ),
        tips_mm,
        arm_mm[len(looks) :],
        most=len(fiducials_mm) * len(targets),
    )
    return [looks[one] for one in found.candidates]


def _order(start_rad: JointVector, looks: Sequence[Reached]) -> list[Reached]:
    """Order the looks axis by axis, each the nearest to the one before, by the joint that turns most."""
    left, ordered, at = list(looks), list[Reached](), np.array(start_rad)
    while left:
        axis = ordered[-1].visit.name.trajectory if ordered else ""
        along = [one for one in left if one.visit.name.trajectory == axis] or left
        nearest = min(along, key=lambda one: float(np.abs(np.subtract(one.at_rad, at)).max()))
        left.remove(nearest)
        ordered.append(nearest)
        at = np.array(nearest.at_rad)
    return ordered


def _check(
    setting: ArmSetting, check: PathCheck, reached: Sequence[Reached], axes: Sequence[Trajectory]
) -> PathCheck:
    """Check the way over all looks to the targets."""
    ends = [setting.start_rad, *(one.approach_rad for one in reached)]
    turns_rad = [float(np.abs(np.subtract(to, at)).max()) for at, to in pairwise(ends)]
    found = PathCheck(check.branch, tuple(reached), (), max(turns_rad))
    if setting.scene is None:
        return found
    return replace(found, unmet=find_unclear(setting, setting.scene, found, axes))
