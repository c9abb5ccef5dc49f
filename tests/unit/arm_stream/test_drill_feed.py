"""Feed of a drill through a skull: slowed by force, ended by a breakthrough or a drill that does not cut."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from ronna_hw.arm_stream.drill_feed import LONGEST_REST_S, DrillFeed, DrillWatch
from ronna_hw.vectors import Vector3
from sim.world.drilling import ThrustModel
from sim.world.skull import SCALP_MM, SkullTables

CYCLE_S = 0.004
FEED_MM_S = 0.5
CT = SkullTables.of()
BEGIN_MM, END_MM = CT.outside_mm - 2.0, CT.inside_mm + 2.5
EARLIEST_MM = CT.inside_mm - 1.0
LIMIT_N = 30.0
AXIS = (0.6, 0.0, -0.8)  # of the feed, robot base
ASIDE = (0.8, 0.0, 0.6)  # across it


class Drilled(NamedTuple):
    """End of a feed: depth below the skin in mm, largest force, theatre time."""

    depth_mm: float
    peak_N: float
    lasted_s: float
    feed: DrillFeed


def watch(bottom_mm: float | None = None) -> DrillWatch:
    """The watch of a feed, below an opening with its bottom there if one was begun."""
    length_mm = END_MM - BEGIN_MM
    bone_by_mm = CT.outside_mm + 2.0 if bottom_mm is None else bottom_mm + 1.0
    return DrillWatch(
        slow_N=18.0,
        hold_N=27.6,
        touch_N=4.0,
        free_N=1.0,
        fall_share=0.4,
        earliest=(EARLIEST_MM - BEGIN_MM) / length_mm,
        free=0.6 / length_mm,
        bone_from=1.0 if bottom_mm is None else (bottom_mm - BEGIN_MM) / length_mm,
        bone_by=(bone_by_mm - BEGIN_MM) / length_mm,
        side_N=8.0,
        friction=0.35,
        axis=AXIS,
    )


def against(force_N: float, side_N: float = 0.0) -> Vector3:
    """The force in the robot base of one against the feed, and one across it."""
    x, y, z = (side_N * aside - force_N * axis for aside, axis in zip(ASIDE, AXIS, strict=True))
    return x, y, z


def drill(
    tables: SkullTables,
    *,
    harder: float = 1.0,
    turns: bool = True,
    scale: float = 1.0,
    side_N: float = 0.0,
    friction: float = 0.0,
    bottom_mm: float | None = None,
) -> Drilled:
    """Feed a drill into a skull until the feed ends, or its way; from 1 mm on a force presses it aside."""
    feed = DrillFeed(watch(bottom_mm), CYCLE_S, in_bone=False)
    thrust = ThrustModel(harder, 0.0 if bottom_mm is None else bottom_mm)
    depth_mm, peak_N, cycles = BEGIN_MM, 0.0, 0
    while depth_mm < END_MM and not feed.has_ended:
        depth_mm += feed.share * FEED_MM_S * CYCLE_S
        force_N = scale * thrust.advance(tables, depth_mm, CYCLE_S if turns else 0.0)
        pressed_N = side_N if depth_mm > BEGIN_MM + 1.0 else 0.0
        felt_N = against(force_N + friction * pressed_N, pressed_N)
        feed.note(felt_N, (depth_mm - BEGIN_MM) / (END_MM - BEGIN_MM))
        peak_N, cycles = max(peak_N, force_N), cycles + 1
    return Drilled(depth_mm, peak_N, cycles * CYCLE_S, feed)


@pytest.mark.hazard(65)
@pytest.mark.parametrize("thicker_mm", [-0.8, 0.0, 0.8])
def test_a_drill_stops_within_a_millimetre_behind_the_skull(thicker_mm: float) -> None:
    true = SkullTables.of(thicker_mm)
    drilled = drill(true)
    assert drilled.feed.has_broken_through
    assert 0.0 < drilled.depth_mm - true.inside_mm < 1.0
    assert drilled.peak_N < LIMIT_N


@pytest.mark.hazard(65)
def test_the_diploe_is_no_breakthrough_and_both_cortices_show_in_the_forces() -> None:
    feed = drill(CT).feed
    bins_mm = (END_MM - BEGIN_MM) / len(feed.forces_N)
    in_diploe = feed.forces_N[int((CT.diploe_mm + 1.5 - BEGIN_MM) / bins_mm)]
    assert in_diploe < 4.0 < 10.0 < max(feed.forces_N[:12])
    assert max(feed.forces_N[-12:]) > 10.0


@pytest.mark.hazard(65)
def test_a_skull_much_thinner_than_in_the_ct_is_left_by_what_no_longer_resists() -> None:
    true = SkullTables.of(-3.5)
    drilled = drill(true)
    assert true.inside_mm < EARLIEST_MM - 2.0
    assert drilled.feed.has_broken_through
    assert drilled.depth_mm - true.inside_mm < 1.8
    assert drilled.depth_mm < EARLIEST_MM


@pytest.mark.hazard(65)
def test_in_a_skull_much_thicker_than_in_the_ct_the_way_ends_first() -> None:
    drilled = drill(SkullTables.of(4.0))
    assert not drilled.feed.has_broken_through
    assert drilled.depth_mm == pytest.approx(END_MM, abs=0.01)


@pytest.mark.hazard(66)
def test_hard_bone_slows_the_feed_below_its_limit() -> None:
    drilled = drill(CT, harder=2.0)
    assert drilled.feed.has_broken_through
    assert drilled.feed.slowed_cycles > 0
    assert drilled.peak_N < LIMIT_N
    assert drilled.lasted_s > drill(CT).lasted_s


@pytest.mark.hazard(66)
def test_a_drill_that_does_not_turn_is_held_and_given_up() -> None:
    drilled = drill(CT, turns=False)
    assert drilled.feed.has_stalled
    assert not drilled.feed.has_broken_through
    assert drilled.peak_N < LIMIT_N
    assert drilled.depth_mm < CT.outside_mm + 1.0
    assert drilled.lasted_s > LONGEST_REST_S


@pytest.mark.hazard(66)
@pytest.mark.parametrize("scale", [0.0, 0.1])
def test_a_drill_whose_sensor_feels_no_bone_is_stopped_in_the_outer_table(scale: float) -> None:
    drilled = drill(CT, scale=scale)
    assert drilled.feed.has_missed_bone
    assert not drilled.feed.has_broken_through
    assert drilled.depth_mm == pytest.approx(CT.outside_mm + 2.0, abs=0.01)


@pytest.mark.hazard(66)
def test_a_force_across_the_drill_is_no_bone_for_a_sensor_whose_axis_along_it_is_dead() -> None:
    drilled = drill(CT, scale=0.02, side_N=4.5)
    assert drilled.feed.has_missed_bone
    assert not drilled.feed.in_bone
    assert drilled.depth_mm == pytest.approx(CT.outside_mm + 2.0, abs=0.01)


@pytest.mark.hazard(65)
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_force_across_the_drill_that_leaves_the_diploe_to_be_felt_hides_no_breakthrough(
    friction: float,
) -> None:
    drilled = drill(CT, side_N=2.0, friction=friction)
    assert drilled.feed.has_broken_through
    assert drilled.depth_mm == pytest.approx(drill(CT).depth_mm, abs=0.05)
    assert drilled.feed.peak_side_N == pytest.approx(2.0)


@pytest.mark.hazard(65)
def test_where_it_may_be_friction_or_diploe_that_resists_the_feed_ends_and_is_no_breakthrough() -> None:
    feed = drill(CT, side_N=7.0).feed
    assert feed.is_hidden
    assert not feed.has_broken_through


@pytest.mark.hazard(65)
@pytest.mark.parametrize("friction", [0.2, 0.42])
@pytest.mark.parametrize("side_N", [2.5, 5.0, 7.0, 7.9])
def test_friction_of_a_drill_pressed_in_its_guide_takes_it_no_deeper_behind_a_thin_skull(
    side_N: float, friction: float
) -> None:
    true = SkullTables.of(-2.8)
    drilled = drill(true, side_N=side_N, friction=friction)
    assert drilled.feed.has_ended
    assert drilled.depth_mm - true.inside_mm < 1.8


@pytest.mark.hazard(66)
def test_friction_is_no_bone_for_a_sensor_whose_axis_along_the_drill_is_dead() -> None:
    drilled = drill(CT, scale=0.02, side_N=7.9, friction=0.4)
    assert drilled.feed.has_missed_bone
    assert not drilled.feed.in_bone


@pytest.mark.hazard(65)
def test_below_an_opening_begun_earlier_the_diploe_is_bone_and_what_is_open_is_fed_1_mm() -> None:
    in_diploe_mm = CT.diploe_mm + 0.5
    through = drill(CT, bottom_mm=in_diploe_mm)
    assert through.feed.has_broken_through
    assert through.depth_mm == pytest.approx(drill(CT).depth_mm, abs=0.1)
    thin = SkullTables.of(-2.8)
    bottom_mm = thin.inside_mm + 1.0  # its lips are through as well
    opened = drill(thin, bottom_mm=bottom_mm)
    assert opened.feed.has_missed_bone
    assert not opened.feed.has_broken_through
    assert opened.depth_mm == pytest.approx(bottom_mm + 1.0, abs=0.01)


@pytest.mark.hazard(65)
def test_the_way_on_which_nothing_resisted_goes_on_over_a_halt() -> None:
    feed = DrillFeed(watch(), CYCLE_S, in_bone=True)
    free = watch().free
    feed.note(against(10.0), 0.1)
    feed.note(against(0.3), 0.1 + 0.9 * free)
    assert feed.free_share == pytest.approx(0.9)
    on = DrillFeed(watch(), CYCLE_S, in_bone=feed.in_bone, free_share=feed.free_share)
    on.note(against(0.3), 0.05 * free)
    assert not on.has_broken_through
    on.note(against(0.3), 0.15 * free)
    assert on.has_broken_through


@pytest.mark.hazard(66)
def test_a_force_across_the_drill_above_its_limit_ends_the_feed() -> None:
    drilled = drill(CT, side_N=8.5)
    assert drilled.feed.is_pushed_aside
    assert not drilled.feed.has_broken_through
    assert drilled.depth_mm < CT.outside_mm


@pytest.mark.hazard(65)
def test_a_drill_that_is_pulled_into_the_opening_meets_no_bone() -> None:
    feed = DrillFeed(watch(), CYCLE_S, in_bone=True)
    for step in range(20):
        feed.note(against(-6.0), step / 100.0)
    assert feed.has_broken_through
    assert max(feed.forces_N) == 0.0


@pytest.mark.hazard(65)
def test_going_on_after_a_halt_before_the_bone_finds_no_breakthrough_in_air() -> None:
    feed = DrillFeed(watch(), CYCLE_S, in_bone=False)
    feed.note(against(0.3), 0.1)
    on = DrillFeed(watch(), CYCLE_S, in_bone=feed.in_bone)
    for step in range(20):
        on.note(against(0.3), step / 100.0)
    assert not on.has_broken_through


def test_a_way_through_air_is_no_breakthrough() -> None:
    assert pytest.approx(5.7) == SCALP_MM
    feed = DrillFeed(watch(), CYCLE_S, in_bone=False)
    for step in range(100):
        feed.note(against(0.3), step / 100.0)
    assert not feed.has_broken_through
