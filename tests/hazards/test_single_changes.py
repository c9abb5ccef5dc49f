"""Hazards 12 and 13: one thing moves after the registration, seen at home before and after each target."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from room_trials import TrackedCase
from single_changes import Moved, PresentWatch, Trial, trial

SCENES, TRIALS_PER_SCENE = 50, 20
MOST_UNSEEN = 0.05


def trials(moved: Moved) -> Iterator[Trial]:
    """1,000 cases over 50 scenes."""
    for seed in range(SCENES):
        case = TrackedCase(seed)
        for _ in range(TRIALS_PER_SCENE):
            yield trial(case, PresentWatch(case), moved)


@pytest.mark.slow
@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_a_thousand_quiet_cases_watched_from_home_raise_no_alarm() -> None:
    assert not any(one.warned.any() for one in trials(Moved.NOTHING))


@pytest.mark.slow
@pytest.mark.hazard(12)
def test_no_head_that_moved_brings_an_error_of_twice_its_limit_unseen() -> None:
    found = list(trials(Moved.HEAD))
    assert sum(one.unseen(2.0) for one in found) == 0
    assert sum(one.unseen(1.0) for one in found) <= MOST_UNSEEN * sum(len(one.ratios) for one in found)


@pytest.mark.slow
@pytest.mark.hazard(13)
@pytest.mark.xfail(
    reason="the watch compares where the frame on the arm is, not how it is turned, and with 0.85 mm",
    strict=True,
)
def test_no_cart_that_moved_brings_an_error_of_twice_its_limit_unseen() -> None:
    assert sum(one.unseen(2.0) for one in trials(Moved.CART)) == 0
