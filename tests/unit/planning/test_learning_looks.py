"""Looks of strategy `learning`: every sphere, no more than `ocs`, in short moves, where the arm can go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np
import pytest
from half_sitting import FIDUCIALS, SIGHT, TRAJECTORIES, arm_setting
from numpy.typing import ArrayLike

from procedures.planning import learning_looks
from procedures.planning.free_angle import TurnedPaths, choose_free_angles
from procedures.planning.learning_looks import CHOICES, choose_learning_looks, look_sides, target_of_look
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import PathCheck, Reached, Unmet, Visit
from procedures.strategies.catalogue import CANDIDATES, find_strategy
from procedures.strategies.strategy import arrival_signs
from ronna_hw.vectors import JointVector

SETTING = arm_setting(strategy=find_strategy("learning"), scene=None)
TARGETS = ("T1", "T2")


@pytest.fixture(scope="module")
def before() -> TurnedPaths:
    """Paths with every sphere as by `ocs`, over the head in a half sitting position."""
    return choose_free_angles(replace(SETTING, strategy=find_strategy("ocs")), TRAJECTORIES, FIDUCIALS, SIGHT)


@pytest.fixture(scope="module")
def chosen(before: TurnedPaths) -> TurnedPaths:
    return choose_learning_looks(SETTING, before, FIDUCIALS, SIGHT)


def looks_of(paths: TurnedPaths) -> list[Reached]:
    return [one for one in paths.check.reached if one.visit.name.kind is PoseKind.FIDUCIAL]


def way_rad(from_rad: JointVector, to: Reached) -> float:
    return float(np.abs(np.subtract(to.at_rad, from_rad)).max())


def test_every_sphere_is_looked_at_from_poses_of_the_strategies_and_not_more_often_than_by_ocs(
    before: TurnedPaths, chosen: TurnedPaths
) -> None:
    looks, kinds = looks_of(chosen), {one.name for one in CANDIDATES}
    assert {one.visit.name.fiducial for one in looks} == set(range(len(FIDUCIALS)))
    assert len(looks) <= len(looks_of(before))
    assert len({one.visit.name for one in looks}) == len(looks)
    for one in looks:
        target, _, kind = one.visit.name.trajectory.rpartition(" ")
        assert target in TARGETS
        assert kind in kinds
    assert chosen.check.targets == before.check.targets
    assert chosen.remark == ""


def test_the_looks_of_an_axis_come_together_and_each_is_the_nearest_that_is_left(chosen: TurnedPaths) -> None:
    looks = looks_of(chosen)
    axes = [axis for axis, _ in groupby(looks, lambda one: one.visit.name.trajectory)]
    assert len(axes) == len(set(axes))
    assert looks[0] == min(looks, key=lambda one: way_rad(SETTING.start_rad, one))
    for number, (one, following) in enumerate(pairwise(looks)):
        left = looks[number + 1 :]
        along = [other for other in left if other.visit.name.trajectory == one.visit.name.trajectory] or left
        assert way_rad(one.at_rad, following) == min(way_rad(one.at_rad, other) for other in along)


def test_each_joint_arrives_at_a_look_from_the_side_from_which_it_arrives_at_the_target_of_its_axis(
    chosen: TurnedPaths,
) -> None:
    sides = {
        one.visit.name.trajectory: arrival_signs(
            SETTING.kinematics, one.visit.pose, one.at_rad, SETTING.flange_from_tool
        )
        for one in chosen.check.targets
    }
    axes = [one.visit.name.trajectory for one in looks_of(chosen)]
    found = look_sides(SETTING, chosen.check.targets, [*axes, "T2"])
    assert found == [*(sides[target_of_look(axis)] for axis in axes), sides["T2"]]
    assert target_of_look("deep left ocs") == "deep left"


@dataclass(frozen=True)
class Hiding(StereoSight):
    """A stereo head to which one sphere is hidden in some poses."""

    hidden: tuple[PoseName, ...] | int = ()

    def unmet(self, visits: Sequence[Visit], spheres_mm: ArrayLike) -> tuple[Unmet, ...]:
        names = [one.name for one in visits]
        if isinstance(self.hidden, int):
            return tuple(Unmet(one, "hidden", "hidden") for one in names if one.fiducial == self.hidden)
        return tuple(Unmet(one, "hidden", "hidden") for one in names if one in self.hidden)


def test_a_pose_that_does_not_see_its_sphere_is_not_chosen(before: TurnedPaths, chosen: TurnedPaths) -> None:
    hidden = tuple(one.visit.name for one in looks_of(chosen)[::2])
    other = choose_learning_looks(SETTING, before, FIDUCIALS, Hiding(SIGHT.left_mm, SIGHT.right_mm, hidden))
    names = {one.visit.name for one in looks_of(other)}
    assert not names & set(hidden)
    assert {one.fiducial for one in names} == set(range(len(FIDUCIALS)))


def test_the_looks_of_ocs_are_used_and_said_to_be_if_a_sphere_has_no_other(before: TurnedPaths) -> None:
    found = choose_learning_looks(SETTING, before, FIDUCIALS, Hiding(SIGHT.left_mm, SIGHT.right_mm, 1))
    assert found.check == before.check
    assert found.remark == "the looks of ocs are used, not chosen ones: no pose to choose from sees sphere 2"


@dataclass
class Collisions:
    """Clearance check that refuses the way to the first look, the first `times`."""

    times: int

    def find_unclear(
        self, _setting: object, _scene: object, check: PathCheck, _axes: object
    ) -> tuple[Unmet, ...]:
        if self.times == 0:
            return ()
        self.times -= 1
        return (Unmet(check.reached[0].visit.name, "the stereo head meets the clamp", ""),)


def test_a_look_that_is_not_clear_is_replaced(
    before: TurnedPaths, chosen: TurnedPaths, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learning_looks, "find_unclear", Collisions(1).find_unclear)
    found = choose_learning_looks(arm_setting(strategy=SETTING.strategy), before, FIDUCIALS, SIGHT)
    names = {one.visit.name for one in looks_of(found)}
    assert looks_of(chosen)[0].visit.name not in names
    assert {one.fiducial for one in names} == set(range(len(FIDUCIALS)))
    assert found.remark == ""


def test_the_looks_of_ocs_are_used_and_said_to_be_if_no_choice_is_clear(
    before: TurnedPaths, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learning_looks, "find_unclear", Collisions(CHOICES).find_unclear)
    found = choose_learning_looks(arm_setting(strategy=SETTING.strategy), before, FIDUCIALS, SIGHT)
    assert found.check == before.check
    assert found.remark.startswith(f"the looks of ocs are used, not chosen ones: of {CHOICES} choices")
    assert found.remark.endswith("the stereo head meets the clamp")
