"""Hazards 12 and 13: shifts at random moments of an approach, with spheres covered for part of the time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from room_trials import TrackedCase
from sight_trials import CoveredApproach, Ended, GuideSight, How, Moved

from procedures.guards.head_sight import MOST_UNSEEN_S

HEAD_MM, CART_MM = 0.5, 1.7
READING_S = 0.2
LATE_SHARE = 0.005  # of the carts that move while the arm does: noticed one motion later, in the same pose
MOST_HIDDEN = 0.1  # of the approaches: 3 of the 150 targets of 50 scenes are hidden by the arm itself
SIZES = [(1, 6), pytest.param(50, 20, marks=[pytest.mark.slow, pytest.mark.timeout(1200)])]  # scenes, trials


def ended(scenes: int, trials: int, moved: Moved, shift_mm: float, *, covers: bool) -> Iterator[Ended]:
    for seed in range(scenes):
        case = TrackedCase(seed)
        sight = GuideSight(case)
        for _ in range(trials):
            yield CoveredApproach(case, sight, moved, shift_mm, covers).run()


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
@pytest.mark.parametrize(("scenes", "trials"), SIZES)
def test_quiet_approaches_raise_no_alarm_and_only_a_covered_head_suspends_them(
    scenes: int, trials: int
) -> None:
    quiet = list(ended(scenes, trials, Moved.NOTHING, 0.0, covers=False))
    assert {one.how for one in quiet if not one.arm_hides} == {How.PASSED}
    assert {one.how for one in quiet} <= {How.PASSED, How.SUSPENDED}
    assert sum(one.arm_hides for one in quiet) <= MOST_HIDDEN * len(quiet)
    assert all(one.expected for one in quiet if one.arm_hides)  # the operator is told before the approach
    covered = {one.how for one in ended(scenes, trials, Moved.NOTHING, 0.0, covers=True)}
    assert How.NOTICED not in covered


@pytest.mark.hazard(12)
@pytest.mark.parametrize(("scenes", "trials"), SIZES)
def test_a_head_shift_is_detected_before_the_next_motion(scenes: int, trials: int) -> None:
    for one in ended(scenes, trials, Moved.HEAD, HEAD_MM, covers=False):
        assert one.how is How.NOTICED or (one.arm_hides and one.how is How.SUSPENDED)
        assert one.begun == 0 or one.unseen_s > READING_S  # the arm itself was in the way over the target


@pytest.mark.hazard(12)
@pytest.mark.parametrize(("scenes", "trials"), SIZES)
def test_no_approach_continues_to_a_head_that_was_covered_for_longer_than_allowed(
    scenes: int, trials: int
) -> None:
    for one in ended(scenes, trials, Moved.HEAD, HEAD_MM, covers=True):
        assert one.how is not How.PASSED
        assert one.unseen_s <= MOST_UNSEEN_S


@pytest.mark.hazard(13)
@pytest.mark.parametrize(("scenes", "trials"), SIZES)
def test_a_cart_shift_is_detected_by_the_time_the_guide_is_out(scenes: int, trials: int) -> None:
    late = 0
    for one in ended(scenes, trials, Moved.CART, CART_MM, covers=False):
        assert one.how is How.NOTICED or (one.arm_hides and one.how is How.SUSPENDED)
        late += one.begun > 0
    assert late <= LATE_SHARE * scenes * trials
