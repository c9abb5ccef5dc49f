"""Choice of free angles about the trajectory axes that make all spheres visible and all poses reachable.

Turns are tried in the strategy's order. The first that keeps the wrist clear of its singularity is used, or
else the clearest; where a tracker is to watch the head during the work, it must also see it past the guide.
If none serves, smaller steps are tried next to turns that lack only a little clearance.
The choice is a result, not a change of the plan: entry, target and axis stay as they are. If no turn serves,
other strategies may.

Near the wrist's singularity, small pose errors become large turns of two joints, and the effect of joint
errors on the tool varies from pose to pose. Registration removes errors common to localizations and
target, so the wrist should have the same configuration at both.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.line_of_sight import StereoSight
from procedures.planning.motions import check_fixed_places
from procedures.planning.paths import check_axes, check_branch, order_branches
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import ArmSetting, Axes, PathCheck, Unmet, list_localizations
from procedures.registration.movement import LEAST_POINTS
from procedures.strategies.catalogue import CANDIDATES, BestOfEach, find_strategy
from procedures.strategies.skin_looks import SKIN, SkinLooks
from procedures.strategies.strategy import (
    FURTHEST_RAD,
    OUTWARDS_RAD,
    STEP_RAD,
    Strategy,
    intermediate_turns_rad,
)
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kinematics import Branch, Kinematics
from ronna_hw.arrays import Array
from ronna_hw.errors import LimitError

# Safety against a wrist near its singularity. Source: simulated cases.
LEAST_BEND_RAD = math.radians(15.0)  # at 5 deg a target error of 0.69 mm was observed, three times the usual
# Safety against a wrist that turns far between localization and target (U).
MOST_TURN_CHANGE_RAD = math.radians(45.0)  # between a localization and the target

LEVER_MM = 270.0  # from the tool's axis to the far side of the hand that carries the default mount
MOST_GAIN_MM = LEVER_MM * STEP_RAD / 2.0  # of clearance, by a turn of half a step
BY_ACCURACY = ("improved", "ocs", "jdms", "nos")  # on an uncalibrated arm


@dataclass(frozen=True)
class TurnedPaths:
    """Paths along the turned axes, with `turns_rad` relative to the planned angles.

    `remark` says where the looks are not those that the strategy would choose, and why.
    """

    check: PathCheck
    axes: Axes
    turns_rad: Mapping[str, float]
    remark: str = ""


def choose_free_angles(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, sight: StereoSight
) -> TurnedPaths:
    """Find an angle for each axis that makes all spheres visible and all poses reachable in one branch.

    Trajectories and fiducials (n, 3) are in CT mm. A turn with a good wrist (see `WristState`) is
    preferred to one that merely passes. If there is none, `check` lists what fails at the planned angles, or
    at the nearest ones with visibility.
    """
    fiducials = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    axes = Axes.of(setting, trajectories, fiducials)
    own = dict.fromkeys((one.identifier for one in axes.distinct), 0.0)
    unmet = check_fixed_places(setting)
    if unmet:
        return TurnedPaths(PathCheck(None, (), unmet), axes, own)
    start = setting.kinematics.branch_of(setting.start_rad)
    search = _Search(setting, fiducials, sight)
    seen = search.find_visible_turns(axes, start)
    nearest = {name: next(turns, 0.0) for name, turns in seen.items()}
    blind_axes = set(own)
    for branch in order_branches(setting, axes.turned(nearest), fiducials):
        options = search.find_visible_turns(axes, branch)
        first = {name: turn for name, turns in options.items() if (turn := next(turns, None)) is not None}
        blind_axes -= first.keys()
        if first.keys() < options.keys():
            continue
        turns = {name: chain((first[name],), others) for name, others in options.items()}
        found = search.in_branch(axes, turns, branch)
        if found is not None:
            return found
    if blind_axes:
        hidden = [
            problem
            for axis in axes.distinct
            if axis.identifier in blind_axes
            for problem in search.hidden(axes.only(axis.identifier), start)
        ]
        return TurnedPaths(PathCheck(None, (), tuple(hidden)), axes, own)
    turned = axes.turned(nearest)
    check = check_axes(setting, turned, fiducials)
    return TurnedPaths(check, turned, nearest) if check.passed else TurnedPaths(check, axes, own)


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for suitable turns, with its constant inputs. Fiducials (n, 3) are in CT coordinates, mm."""

    setting: ArmSetting
    fiducials_mm: Array
    sight: StereoSight

    def in_branch(
        self, axes: Axes, options: Mapping[str, Iterable[float]], branch: Branch
    ) -> TurnedPaths | None:
        """Find turns that work together in this branch, trying each axis's best first, or return None."""
        ranked: dict[str, Iterator[float]] = {}
        chosen: dict[str, float] = {}
        for name, turns in options.items():  # the localizations that all targets share come first
            ordered = _nearest_to_shared(axes, name, turns, chosen)
            ranked[name] = self._search_turns(axes.only(name), ordered, branch)
            first = next(ranked[name], None)
            if first is None:
                return None
            chosen[name] = first
        while True:
            turned = axes.turned(chosen)
            check = check_branch(self.setting, turned, self.fiducials_mm, branch)
            if check.passed:
                return TurnedPaths(check, turned, chosen)
            # Each passes alone, but here it is approached from elsewhere: a joint may be off by a whole turn.
            failed = {problem.pose.trajectory for problem in check.unmet}
            for name in [one for one in chosen if one in failed]:
                other = next(ranked[name], None)
                if other is None:
                    return None
                chosen[name] = other

    def _search_turns(self, axis: Axes, turns: Iterable[float], branch: Branch) -> Iterator[float]:
        """Yield the suitable turns in this branch, then intermediate turns next to near misses."""
        near_misses = yield from self._rank_turns(axis, turns, branch)
        between = (
            turn for turn in intermediate_turns_rad(near_misses) if not self.hidden(_turn(axis, turn), branch)
        )
        yield from self._rank_turns(axis, between, branch)

    def _rank_turns(
        self, axis: Axes, turns: Iterable[float], branch: Branch
    ) -> Generator[float, None, list[float]]:
        """Yield the suitable turns in this branch: good wrists in order, then the others, best first.

        Returns those that only lack some clearance, no more than a turn by half a step may gain.
        """
        others: list[tuple[bool, float, float]] = []
        near_misses: list[float] = []
        for turn in turns:
            check = check_branch(self.setting, _turn(axis, turn), self.fiducials_mm, branch, first_only=True)
            if not check.passed:
                if all(one.short_mm is not None and one.short_mm < MOST_GAIN_MM for one in check.unmet):
                    near_misses.append(turn)
                continue
            wrist, in_view = WristState.of(self.setting.kinematics, check), self._leaves_head_in_view(check)
            if wrist.is_good and in_view:
                yield turn
            else:
                others.append((in_view, wrist.least_bend_rad, turn))
        for _, _, turn in sorted(others, key=lambda one: one[:2], reverse=True):
            yield turn
        return near_misses

    def _leaves_head_in_view(self, check: PathCheck) -> bool:
        """Return whether a tracker, if one counts, sees enough of the head past the guide at all targets."""
        setting = self.setting
        if not setting.sights or setting.scene is None:
            return True
        around = setting.scene.with_guide(setting.robot_from_ct, setting.flange_from_tool, None)
        return all(
            any(
                int(sight.seen(setting.kinematics, around, one.at_rad).sum()) >= LEAST_POINTS
                for sight in setting.sights
            )
            for one in check.reached
            if one.visit.name.kind is PoseKind.TARGET
        )

    def find_visible_turns(self, axes: Axes, branch: Branch) -> dict[str, Iterator[float]]:
        """Find the turns at which every sphere is visible, by axis and in the strategy's order.

        Usually the first will do, and checking the others takes most of the time: each is computed on demand.
        """
        setting, arm = self.setting, self.setting.in_branch(branch)

        def turns_along(one: Trajectory) -> Iterator[float]:
            axis = axes.only(one.identifier)
            if one.identifier == SKIN:  # these poses are given
                yield 0.0
                return
            for turn in setting.strategy.turns_rad(one, self.fiducials_mm, setting.robot_from_ct, arm):
                if not self.hidden(_turn(axis, turn), branch):
                    yield turn

        return {one.identifier: turns_along(one) for one in axes.distinct}

    def hidden(self, axis: Axes, branch: Branch) -> tuple[Unmet, ...]:
        unmet: list[Unmet] = []
        for one in axis.localized:
            if one.identifier == SKIN:  # chosen for what they see
                continue
            try:
                visits = list_localizations(self.setting, one, self.fiducials_mm, branch)
            except LimitError as error:
                unmet.append(Unmet.from_error(PoseName(PoseKind.FIDUCIALS, one.identifier), error))
            else:
                unmet += self.sight.unmet(visits, self.setting.robot_from_ct.apply(self.fiducials_mm))
        return tuple(unmet)


def _nearest_to_shared(
    axes: Axes, name: str, turns: Iterable[float], chosen: Mapping[str, float]
) -> Iterable[float]:
    """Order a target's turns by nearness to the free angle of the localizations that it shares, if it does.

    The thesis keeps that angle between localization and target. A target with localizations of its own keeps
    it anyway, and the order of its turns.
    """
    if not axes.localized or name in {one.identifier for one in axes.localized}:
        return turns
    shared = axes.localized[0]
    (planned,) = (one.free_angle_rad for one in axes.targeted if one.identifier == name)
    kept = math.remainder(shared.free_angle_rad + chosen[shared.identifier] - planned, 2.0 * math.pi)
    reachable = {kept} if abs(kept) <= FURTHEST_RAD else set()
    return sorted({*turns} | reachable, key=lambda turn: abs(turn - kept))


def _turn(axis: Axes, turn_rad: float) -> Axes:
    return axis.turned({one.identifier: turn_rad for one in axis.distinct})


@dataclass(frozen=True)
class WristState:
    """Smallest wrist bend over all poses and approaches, and largest wrist rotation from sphere to target.

    A whole turn counts as a change: the arm would have to make it in between.
    """

    least_bend_rad: float
    largest_turn_change_rad: float

    @classmethod
    def of(cls, kinematics: Kinematics, check: PathCheck) -> Self:
        """Evaluate the poses of one trajectory. The check must have reached its target."""
        turns: dict[PoseKind, list[float]] = {PoseKind.FIDUCIAL: [], PoseKind.TARGET: []}
        for one in check.reached:
            turns[one.visit.name.kind].append(kinematics.wrist_turn_rad(one.at_rad))
        pairs = product(turns[PoseKind.TARGET], turns[PoseKind.FIDUCIAL])
        joints = (each for one in check.reached for each in (one.approach_rad, one.at_rad))
        least_bend_rad = min(map(kinematics.wrist_bend_rad, joints))
        return cls(least_bend_rad, max((abs(target - sphere) for target, sphere in pairs), default=0.0))

    @property
    def is_good(self) -> bool:
        """Whether the wrist avoids its singularity and keeps one configuration at spheres and target."""
        return self.least_bend_rad >= LEAST_BEND_RAD and self.largest_turn_change_rad < MOST_TURN_CHANGE_RAD


def find_alternatives(
    setting: ArmSetting,
    trajectory: Trajectory,
    fiducials_mm: ArrayLike,
    sight: StereoSight,
    tried: Collection[str] = (),
) -> tuple[Strategy, ...]:
    """Find strategies under which this trajectory alone would be visible, reachable and clear, best first.

    The trajectory and the fiducials (n, 3) are in CT mm. The case's own and those already tried are left out.
    """
    if isinstance(setting.strategy, SkinLooks) or not _is_target_reachable(setting, trajectory):
        return ()  # without spheres there is but one
    known = {setting.strategy.name, *tried}
    if isinstance(setting.strategy, BestOfEach):
        known |= {one.name for one in CANDIDATES}
    candidates = (find_strategy(name) for name in BY_ACCURACY if name not in known)
    return tuple(
        one
        for one in candidates
        if choose_free_angles(
            replace(setting, strategy=one, skin_looks=()), (trajectory,), fiducials_mm, sight
        ).check.passed
    )


def find_unreached(check: PathCheck, trajectories: Sequence[Trajectory]) -> dict[str, str]:
    """Find the trajectories that failed a path check, each with its first reason.

    A failure that belongs to none of them, such as in a neutral orientation, applies to all.
    """
    reasons: dict[str, str] = {}
    for unmet in check.unmet:
        reasons.setdefault(unmet.pose.trajectory, f"{unmet.pose}: {unmet.reason}")
    own = {one.identifier: reasons[one.identifier] for one in trajectories if one.identifier in reasons}
    if len(own) == len(reasons):
        return own
    shared = next(iter(reasons.values()))
    return {one.identifier: own.get(one.identifier, shared) for one in trajectories}


def advice(alternatives_by_trajectory: Mapping[str, Sequence[Strategy]]) -> str | None:
    """Recommend strategies that would reach the trajectories, or return None if none would."""
    reaching = [
        f"{name} by {' or '.join(one.name for one in others)}"
        for name, others in alternatives_by_trajectory.items()
        if others
    ]
    if not reaching:
        return None
    ways = ", ".join(reaching)
    return f"Choose another --strategy, which would reach {ways}; or move the cart or the head."


def _is_target_reachable(setting: ArmSetting, trajectory: Trajectory) -> bool:
    """Whether the guide reaches the target at any angle in any branch."""
    return any(
        check_branch(setting, target, (), branch, first_only=True).passed
        for branch in setting.kinematics.branches
        for turn in OUTWARDS_RAD
        for target in (Axes((), (trajectory,)).turned({trajectory.identifier: turn}),)
    )
