"""Outlines in pictures by a path tracer: stated errors in light that the simulated cameras do not have."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.stereo_head.traced_views import (
    BRIGHT_DRAPE,
    ORDINARY,
    SATURATED,
    SATURATED_DRAPE,
    SATURATED_SIDE,
    SIDE_LAMP,
    STRONG_SIDE_LAMP,
    expose,
    kept_views,
    measure_views,
)
from procedures.relocalization import SphereStatus, measure_sphere
from procedures.relocalization.outline import ONE_SIDED, SATURATED_SIDE_OF_RIM


@pytest.fixture(scope="module")
def views():
    return list(kept_views())


@pytest.fixture(scope="module")
def outcome_in(views):
    """Outcome of one exposure of every view in a light, measured once."""
    return cache(lambda light: measure_views(views, light, exposures=1))


# Five views leave ten degrees of freedom: an honest error has a chi square of 0.25 to 2.3 in 98 % of cases.
@pytest.mark.parametrize(
    "light", [ORDINARY, BRIGHT_DRAPE, SATURATED, SATURATED_DRAPE], ids=lambda each: each.name
)
def test_the_stated_error_is_honest_in_front_of_any_drape_and_on_a_clipped_film(outcome_in, light):
    outcome = outcome_in(light)
    assert not outcome.refused
    assert 0.25 < outcome.chi_square < 2.3


def test_the_stated_error_grows_before_a_bright_drape_as_the_error_does(outcome_in):
    dark, bright = outcome_in(ORDINARY), outcome_in(BRIGHT_DRAPE)
    assert bright.rms_px > 3.0 * dark.rms_px
    assert bright.stated_px > 3.0 * dark.stated_px


@pytest.mark.parametrize("light", [SIDE_LAMP, STRONG_SIDE_LAMP], ids=lambda each: each.name)
def test_a_lamp_from_the_side_is_measured_honestly(outcome_in, light):
    outcome = outcome_in(light)
    assert len(outcome.errors_px) >= 2
    assert 0.25 < outcome.chi_square < 2.3


@pytest.mark.hazard(27)
def test_a_side_left_dark_by_a_lamp_is_named(outcome_in):
    assert outcome_in(STRONG_SIDE_LAMP).refused[ONE_SIDED] > 0


@pytest.mark.hazard(27)
def test_a_rim_saturated_on_one_side_is_never_trusted(outcome_in):
    outcome = outcome_in(SATURATED_SIDE)
    assert not outcome.errors_px
    assert outcome.refused[SATURATED_SIDE_OF_RIM] >= 3


def test_the_direction_of_a_bright_drape_is_the_direction_of_the_stated_error(views):
    """A ramp of drape light from dark to film: the rim may be off along the ramp, not across."""
    view = views[0]
    picture = expose(view, ORDINARY, np.random.default_rng(3))
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    is_drape = np.hypot(columns - view.centre_px[0], rows - view.centre_px[1]) > view.radius_px + 1.0
    ramp = np.where(is_drape, 120.0 * columns / picture.shape[1], 0.0)
    found = measure_sphere((np.minimum(picture + ramp, 255.0)).astype(np.uint8))
    assert found.status is SphereStatus.OK
    assert found.covariance_px2[0][0] > 2.0 * found.covariance_px2[1][1]
