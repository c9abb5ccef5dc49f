"""Views of the skin in the order that takes the arm least time."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from half_sitting import HEAD, arm_setting

from procedures.planning.skin_tour import tour_views
from procedures.planning.skin_views import choose_views, is_clear
from procedures.planning.visits import ArmSetting, Reached
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Part, Surroundings
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector, vector3

NEEDED, LOOK_S = 2, 2.0


@pytest.fixture(scope="module")
def setting() -> ArmSetting:
    return arm_setting(scene=None)


@pytest.fixture(scope="module")
def views(setting: ArmSetting) -> tuple[Reached, ...]:
    turns = np.linspace(-0.6, 0.6, 4)
    outwards = np.array([(np.sin(x), -np.cos(x), z) for x, z in itertools.product(turns, (0.2, 0.6))])
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    places = np.asarray(HEAD.centre_mm) + 85.0 * outwards
    branch = setting.kinematics.branch_of(setting.start_rad)
    found = choose_views(setting, branch, places, outwards, 6)
    assert len(found) >= 4
    return found


def places_of(views: tuple[Reached, ...]) -> list[tuple[float, ...]]:
    return sorted(tuple(one.visit.pose.translation_mm.round(6).tolist()) for one in views)


def travel_rad(setting: ArmSetting, views: tuple[Reached, ...]) -> float:
    joints = [setting.start_rad, *(one.at_rad for one in views)]
    return sum(float(np.abs(np.subtract(*pair)).max()) for pair in itertools.pairwise(joints))


def test_each_place_is_looked_at_once_and_the_axis_of_the_look_stays(
    setting: ArmSetting, views: tuple[Reached, ...]
) -> None:
    tour = tour_views(setting, views, NEEDED, LOOK_S, np.inf)
    assert places_of(tour) == places_of(views)
    axes = {
        tuple(one.visit.pose.translation_mm.round(6)): one.visit.pose.rotation_matrix[:, 2] for one in views
    }
    for one in tour:
        assert one.visit.pose.rotation_matrix[:, 2] == pytest.approx(
            axes[tuple(one.visit.pose.translation_mm.round(6))]
        )


def test_the_joints_turn_less_than_in_the_order_given(
    setting: ArmSetting, views: tuple[Reached, ...]
) -> None:
    assert travel_rad(setting, tour_views(setting, views, NEEDED, LOOK_S, np.inf)) < travel_rad(
        setting, views
    )


def test_a_tour_ends_once_more_at_the_first_view_that_may_close_it(
    setting: ArmSetting, views: tuple[Reached, ...]
) -> None:
    may_close = [number in (1, 3) for number in range(len(views))]
    tour = tour_views(setting, views, NEEDED, LOOK_S, np.inf, may_close)
    assert places_of(tour[:-1]) == places_of(views)
    closing = set(places_of((views[1], views[3])))
    first = next(one for one in tour if places_of((one,))[0] in closing)
    assert places_of(tour[-1:]) == places_of((first,))


def test_views_are_left_out_for_time_but_never_those_that_are_needed(
    setting: ArmSetting, views: tuple[Reached, ...]
) -> None:
    short = tour_views(setting, views, NEEDED, LOOK_S, 0.0)
    assert places_of(short) == places_of(views[:NEEDED])
    # A look takes longer than all ways together: the limit is for all but one.
    long_s = 100.0
    fewer = tour_views(setting, views, NEEDED, long_s, long_s * (len(views) - 0.5))
    assert len(fewer) == len(views) - 1
    assert set(places_of(fewer)) > set(places_of(views[:NEEDED]))


def ball_beside_approach(setting: ArmSetting, view: Reached, gap_mm: float) -> Surroundings:
    """Place a ball beside the tool where the line to a view begins, on the side away from both ways on."""
    at_flange_mm, radius_mm = (0.0, 0.0, 200.0), 20.0

    def tool_mm(joints_rad: JointVector) -> Array:
        return np.asarray(setting.kinematics.forward(joints_rad).apply(at_flange_mm))

    here_mm = tool_mm(view.approach_rad)
    ways = [tool_mm(joints) - here_mm for joints in (view.at_rad, setting.start_rad)]
    away = sum(way / np.linalg.norm(way) for way in ways)
    centre_mm = vector3(here_mm - (2.0 * radius_mm + gap_mm) * away / np.linalg.norm(away))
    return Surroundings(
        tool=(Part("head", Capsule(at_flange_mm, at_flange_mm, radius_mm)),),
        obstacles=(Obstacle("ball", Capsule(centre_mm, centre_mm, radius_mm)),),
    )


@pytest.mark.parametrize(("gap_mm", "clear"), [(9.0, False), (11.0, True)])
def test_a_view_whose_line_begins_too_close_to_a_body_is_not_clear(
    setting: ArmSetting, views: tuple[Reached, ...], gap_mm: float, clear: bool
) -> None:
    assert is_clear(setting, views[0], ball_beside_approach(setting, views[0], gap_mm)) is clear
