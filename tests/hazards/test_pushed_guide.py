"""Hazard 46: tracker noise alone never counts as a hand on the guide, and a push always does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from room_trials import TrackedCase

from procedures.guards.guide_still import (
    END_READINGS,
    END_SEEN_MM,
    FRAMES,
    FRAMES_AT_FIRST,
    PLACE_READINGS,
    PUSHED_MM,
)

SCENES, TRIALS_PER_TARGET = 30, 20
READINGS = 9000  # ten minutes of work through the guide, of every fourth frame
LOOKS = 4  # one after each stage
PLACES, ENDS = [0, 1, 2, 6, 7, 8], [3, 4, 5]
pytestmark = pytest.mark.hazard(46)
Array = NDArray[np.float64]


def running_mean(values: Array, count: int) -> Array:
    sums = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return np.asarray((sums[count:] - sums[:-count]) / count)


def insertions(pushed_mm: float, turned_mm: float, readings: int) -> Iterator[tuple[bool, bool]]:
    """Whether the watch warns, and the looks after each stage.

    Pushed by so much, and turned about the frame so far that the guide's end moves by so much.
    """
    for seed in range(SCENES):
        case = TrackedCase(seed)
        rests = case.rests
        for at in rests[-3 * ((len(rests) - 2) // 4) :][1::3]:
            noise_mm = case.guide_noise_mm(at)

            def means_mm(
                frames: int, count: int, noise_mm: Array = noise_mm, case: TrackedCase = case
            ) -> Array:
                drawn = case.generator.standard_normal((count, 9))
                return drawn @ noise_mm.T / np.sqrt(frames)

            for _ in range(TRIALS_PER_TARGET):
                shift_mm = pushed_mm * case.direction()
                end_mm = shift_mm + turned_mm * case.direction()
                away_mm = np.concatenate([shift_mm, end_mm, shift_mm])
                away_mm -= means_mm(FRAMES, 1)[0]
                running_mm = means_mm(1, readings) + away_mm
                places_mm = running_mean(running_mm[:, PLACES], PLACE_READINGS)
                ends_mm = running_mean(running_mm[:, ENDS], END_READINGS)
                looks = zip(means_mm(FRAMES_AT_FIRST, LOOKS), means_mm(FRAMES, LOOKS), strict=True)
                yield (
                    warns(places_mm, ends_mm),
                    any(all(warns_once(mean_mm + away_mm) for mean_mm in look) for look in looks),
                )


def warns(places_mm: Array, ends_mm: Array) -> bool:
    by_place = np.linalg.norm(places_mm.reshape(-1, 3), axis=1) > PUSHED_MM
    by_end = np.linalg.norm(ends_mm, axis=1) > END_SEEN_MM
    return bool(by_place.any() or by_end.any())


def warns_once(mean_mm: Array) -> bool:
    return warns(mean_mm[None, PLACES], mean_mm[None, ENDS])


def test_at_most_one_undisturbed_insertion_of_ten_minutes_in_a_thousand_warns_of_a_push() -> None:
    warned = np.array(list(insertions(0.0, 0.0, READINGS)))
    assert len(warned) >= 1500
    assert warned.mean(axis=0).max() <= 0.001


@pytest.mark.parametrize(
    ("pushed_mm", "turned_mm", "readings"),
    [(2.0 * PUSHED_MM, 0.0, PLACE_READINGS), (0.0, 2.0 * END_SEEN_MM, END_READINGS)],
    ids=["push within two seconds", "turn within ten seconds"],
)
def test_a_hand_that_moves_the_guide_by_twice_the_limit_is_seen(
    pushed_mm: float, turned_mm: float, readings: int
) -> None:
    assert np.array(list(insertions(pushed_mm, turned_mm, readings))).all()
