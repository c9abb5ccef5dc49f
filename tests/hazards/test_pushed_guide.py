"""Hazard 46: tracker noise alone never counts as a hand on the guide, and a push always does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from room_trials import TrackedCase

from procedures.guards.guide_displacement import (
    END_READINGS,
    END_SEEN_MM,
    FRAMES,
    FRAMES_AT_FIRST,
    PLACE_READINGS,
    PUSHED_MM,
)
from ronna_hw.arrays import Array

SCENES, TRIALS_PER_TARGET = 30, 20
FEW_SCENES = 10
READINGS = 9000  # ten minutes of work through the guide, of every fourth frame
LOOKS = 4  # one after each stage
PLACES, ENDS = (slice(0, 3), slice(6, 9)), slice(3, 6)
pytestmark = pytest.mark.hazard(46)


def running_mean(values: Array, count: int) -> Array:
    """Of each row."""
    sums = np.zeros((len(values), values.shape[1] + 1))
    np.cumsum(values, axis=1, out=sums[:, 1:])
    return np.asarray((sums[:, count:] - sums[:, :-count]) / count)


def insertions(
    pushed_mm: float, turned_mm: float, readings: int, scenes: int = SCENES
) -> Iterator[tuple[bool, bool]]:
    """Whether the watch warns, and the looks after each stage.

    Pushed by so much, and turned about the frame so far that the guide's end moves by so much.
    """
    for seed in range(scenes):
        case = TrackedCase(seed)
        rests = case.rests
        for at in rests[-3 * ((len(rests) - 2) // 4) :][1::3]:
            noise_mm = case.guide_noise_mm(at)

            def means_mm(
                frames: int, count: int, noise_mm: Array = noise_mm, case: TrackedCase = case
            ) -> Array:
                drawn = case.generator.standard_normal((9, count))
                return np.asarray(noise_mm / np.sqrt(frames) @ drawn)

            for _ in range(TRIALS_PER_TARGET):
                shift_mm = pushed_mm * case.direction()
                end_mm = shift_mm + turned_mm * case.direction()
                away_mm = np.concatenate([shift_mm, end_mm, shift_mm])[:, None]
                away_mm = away_mm - means_mm(FRAMES, 1)
                running_mm = means_mm(1, readings) + away_mm
                places_mm = [running_mean(running_mm[three], PLACE_READINGS) for three in PLACES]
                ends_mm = running_mean(running_mm[ENDS], END_READINGS)
                looks = [means_mm(frames, LOOKS) + away_mm for frames in (FRAMES_AT_FIRST, FRAMES)]
                yield (
                    bool(any(beyond(one, PUSHED_MM).any() for one in places_mm))
                    or bool(beyond(ends_mm, END_SEEN_MM).any()),
                    bool(np.logical_and(*(warns_once(look) for look in looks)).any()),
                )


def beyond(vectors_mm: Array, limit_mm: float) -> NDArray[np.bool_]:
    """Which columns are longer."""
    return np.asarray(np.einsum("ij,ij->j", vectors_mm, vectors_mm) > limit_mm**2)


def warns_once(means_mm: Array) -> NDArray[np.bool_]:
    """By column."""
    by_place = [beyond(means_mm[three], PUSHED_MM) for three in PLACES]
    return np.asarray(by_place[0] | by_place[1] | beyond(means_mm[ENDS], END_SEEN_MM))


@pytest.mark.slow
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
    assert np.array(list(insertions(pushed_mm, turned_mm, readings, FEW_SCENES))).all()
