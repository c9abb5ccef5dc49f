from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import pytest
from coded_errors import raises

from ronna_hw.arguments import WrongArgument
from ronna_hw.devices import new_frames
from ronna_hw.devices.errors import NO_NEW_FRAME
from ronna_hw.devices.readings import Stamp, TrackerFrame, Validity


def tracker(*validities: Validity) -> Any:
    """Says these again and again, with the number of the reading as the frame's number."""
    frames = (
        TrackerFrame(Stamp(number, number, 0.0), validity, (), ())
        for number, validity in enumerate(itertools.cycle(validities))
    )
    return SimpleNamespace(name="tracker", read_frame=lambda timeout_s: next(frames))


def test_repeated_measurements_are_skipped() -> None:
    frames = new_frames(tracker(Validity.OK, Validity.STALE), 3)
    assert [frame.stamp.sequence for frame in frames] == [0, 2, 4]


def test_new_frames_without_a_count_never_end() -> None:
    assert len(list(itertools.islice(new_frames(tracker(Validity.OK)), 1000))) == 1000


def test_a_count_of_frames_that_is_none_is_refused_at_once() -> None:
    assert list(new_frames(tracker(Validity.OK), 0)) == []
    for count in (-1, 2.5, "3"):
        with pytest.raises(WrongArgument, match="ARG-001: the count of new frames"):
            new_frames(tracker(Validity.OK), count)  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(WrongArgument, match="ARG-001: this is no tracker"):
        new_frames(None, 60)  # type: ignore[arg-type]  # wrong on purpose


def test_a_tracker_without_new_measurements_is_an_error_after_the_time_limit() -> None:
    with raises(NO_NEW_FRAME, match=r"limit 0\.02 s"):
        next(new_frames(tracker(Validity.STALE), timeout_s=0.02))
