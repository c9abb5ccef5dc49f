"""Hazard 46: tracker noise alone never counts as a hand on the guide, and a push always does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from room_trials import STILL, TrackedCase

from procedures.guards.guide_still import FRAMES, PUSHED_MM, RUNNING_FRAMES

SCENES, TRIALS_PER_TARGET = 30, 20
READINGS = 9000  # ten minutes of work through the guide, of every fourth frame
LOOKS = 4  # one after each stage
pytestmark = pytest.mark.hazard(46)
Array = NDArray[np.float64]


def insertions(pushed_mm: float, readings: int) -> Iterator[tuple[float, float]]:
    """The largest displacement seen by the running mean of the watch, and by the looks after each stage."""
    for seed in range(SCENES):
        case = TrackedCase(seed)
        rests = case.rests
        for at in rests[-3 * ((len(rests) - 2) // 4) :][1::3]:
            noise_mm = case.frame_noise_mm(at)

            def means_mm(
                frames: int, count: int, noise_mm: Array = noise_mm, case: TrackedCase = case
            ) -> Array:
                drawn = case.generator.standard_normal((count, 3))
                return drawn @ noise_mm.T / np.sqrt(frames)

            for _ in range(TRIALS_PER_TARGET):
                beside_mm = pushed_mm * case.direction() - means_mm(FRAMES, 1)
                sums = np.cumsum(np.vstack([STILL, means_mm(1, readings)]), axis=0)
                running = (sums[RUNNING_FRAMES:] - sums[:-RUNNING_FRAMES]) / RUNNING_FRAMES
                seen = (running + beside_mm, means_mm(FRAMES, LOOKS) + beside_mm)
                watched, looked = (float(np.linalg.norm(way_mm, axis=1).max()) for way_mm in seen)
                yield watched, looked


def test_at_most_one_undisturbed_insertion_of_ten_minutes_in_a_thousand_warns_of_a_push() -> None:
    watched, looked = np.array(list(insertions(0.0, READINGS))).T
    assert len(watched) >= 1500
    assert np.mean(watched > PUSHED_MM) <= 0.001
    assert looked.max() <= 0.9 * PUSHED_MM
    assert 0.04 < np.median(looked) < 0.06


def test_a_push_of_twice_the_limit_is_seen_within_two_seconds() -> None:
    watched, looked = np.array(list(insertions(2.0 * PUSHED_MM, RUNNING_FRAMES))).T
    assert min(watched.min(), looked.min()) > PUSHED_MM
