"""The doctor judges images by what a case needs of them, and says what it could not judge."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, cast

import numpy as np
import pytest
from recording_cell import STAMP, mini_theatre
from scipy.ndimage import gaussian_filter

from procedures.cli.doctor.pictures import pair_diagnostics
from procedures.workcell.stereo_look import FURTHER_TRIES
from ronna_hw.devices.probing import Diagnostic, picture_diagnostics
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, StereoReading, Validity

SIZE_PX, RADIUS_PX = 700, 261
DARK_GREY = 6.0


@cache
def image(sphere_grey: float, blur_px: float = 1.0, radius_px: float = RADIUS_PX) -> CameraImage:
    y, x = np.mgrid[0:SIZE_PX, 0:SIZE_PX]
    disc = np.clip(radius_px - np.hypot(x - 350.3, y - 348.6) + 0.5, 0.0, 1.0)
    noise = np.random.default_rng(1).normal(0.0, 2.0, disc.shape)
    grey = gaussian_filter(DARK_GREY + sphere_grey * disc, blur_px) + noise
    pixels = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    return CameraImage(STAMP, Validity.OK, "1", pixels, AreaOfInterest(0, 0, SIZE_PX, SIZE_PX))


Shown = tuple[float, ...]  # arguments of `image`: nothing is drawn before a test runs
GOOD: Shown = (150.0,)
NOTHING: Shown = (0.0,)


def judged(left: Shown, right: Shown, *, calibrated: bool = True) -> tuple[Diagnostic, ...]:
    calibration = mini_theatre().calibration
    assert calibration is not None
    pair = StereoReading(STAMP, Validity.OK, image(*left), image(*right))
    return tuple(pair_diagnostics("stereo: ", pair, calibration.stereo_head if calibrated else None))


@pytest.mark.parametrize(
    ("left", "well", "said"),
    [
        (GOOD, True, "a sphere to 0.0"),
        (NOTHING, False, "too dark"),  # the other camera sees the sphere
        ((6.0,), False, "too dark"),
        ((150.0, 16.0), False, "not sharp"),
        ((400.0,), False, "too bright"),
        ((150.0, 1.0, 120.0), True, "exposure and focus were not judged: no sphere near the tool"),
    ],
    ids=["good", "dark", "faint", "out of focus", "saturated", "a sphere elsewhere"],
)
def test_a_camera_is_judged_by_a_sphere_near_the_tool_centre(left: Shown, well: bool, said: str) -> None:
    of_left, of_right = judged(left, GOOD)
    assert (of_left.well, said in of_left.seen) == (well, True), of_left
    assert bool(of_left.advice) is (left is not GOOD)
    assert of_right.well


@pytest.mark.parametrize("calibrated", [True, False])
def test_of_cameras_without_a_sphere_in_view_the_doctor_says_that_they_were_not_judged(
    calibrated: bool,
) -> None:
    for one in judged(NOTHING, NOTHING, calibrated=calibrated):
        assert one.well
        assert "exposure and focus were not judged" in one.seen
        assert "ronna-stereo measure --find" in one.advice


class LosingPair:
    """A pair of which the first few come incomplete."""

    def __init__(self, lost: int, how: Validity = Validity.PARTIAL) -> None:
        self._lost, self._how = lost, how

    @contextmanager
    def active(self) -> Iterator[None]:
        yield

    def grab_pair(self) -> StereoReading:
        self._lost -= 1
        return StereoReading(STAMP, self._how if self._lost >= 0 else Validity.OK, None, None)


@pytest.mark.parametrize(("lost", "well"), [(0, True), (2, True), (3, False), (50, False)])
def test_as_many_pairs_may_be_lost_as_a_case_makes_up_for_by_taking_them_again(lost: int, well: bool) -> None:
    pair = cast("Any", LosingPair(lost))
    (pictures,) = picture_diagnostics("stereo: ", pair, 50, 1 + FURTHER_TRIES, lambda _last: iter(()))
    assert pictures.well is well
    assert bool(pictures.advice) is (lost > 0)


@pytest.mark.parametrize(("load", "named"), [(9.0, True), (0.1, False)])
def test_pairs_that_come_late_name_the_load_of_the_computer_as_a_cause(
    monkeypatch: pytest.MonkeyPatch, load: float, named: bool
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {0, 1})
    monkeypatch.setattr(os, "getloadavg", lambda: (load, load, load))
    pair = cast("Any", LosingPair(3, Validity.UNPAIRED))
    (pictures,) = picture_diagnostics("stereo: ", pair, 50, 1, lambda _last: iter(()))
    assert "47 of 50 pairs arrived complete, 3 unpaired" in pictures.seen
    assert "Images come late" in pictures.advice
    assert ("a load of 9.0 on 2 processors" in pictures.advice) is named
