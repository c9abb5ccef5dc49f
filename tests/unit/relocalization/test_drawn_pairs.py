"""Triangulated centres from the simulated cameras' images with the true calibration: a few by default."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.stereo_head.sphere_campaign import (
    CENTRED,
    DECEIVING,
    DEFOCUSED,
    HALF_HIDDEN,
    HONEST,
    JUST_HIDDEN,
    OCCLUDED,
    OFF_AXIS,
    SPHERE_SIZED_GLARE,
    campaign,
    deceive,
)
from benchmarks.stereo_head.stereo_pictures import Studio


@pytest.mark.parametrize(
    ("case", "limit_um"), [(CENTRED, 2.0), (DEFOCUSED, 2.0), (OFF_AXIS, 1.0), (OCCLUDED, 10.0)]
)
def test_a_few_pairs_give_points_within_the_accuracy_goal(case, limit_um):
    tally = campaign(Studio(), case, 2)
    assert tally.trusted == tally.images
    assert tally.rms_um <= limit_um


@pytest.mark.hazard(27)
def test_no_centre_is_trusted_beyond_38_percent_of_hidden_rim():
    tally = campaign(Studio(), JUST_HIDDEN, 2)
    assert tally.trusted == 0


@pytest.mark.soak
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("case", "limit_um"), [(CENTRED, 2.0), (DEFOCUSED, 2.0), (OFF_AXIS, 1.0), (OCCLUDED, 10.0)]
)
def test_hundreds_of_pairs_give_points_within_the_accuracy_goal_and_honest_covariances(case, limit_um):
    tally = campaign(Studio(), case, 300, seed=11)
    assert tally.rms_um <= limit_um
    assert tally.largest_um <= 3 * limit_um
    assert tally.bound_um < tally.rms_um  # nothing beats the Cramér-Rao bound
    low, high = HONEST
    assert low <= tally.chi_square <= high
    beyond_three_sigmas = np.mean(np.array(tally.squared_sigmas) > 16.3)  # 0.1 % of chi-square with three
    assert beyond_three_sigmas < 0.03  # stains and grain are not normal


@pytest.mark.soak
@pytest.mark.timeout(1200)
@pytest.mark.hazard(27)
@pytest.mark.parametrize("case", [HALF_HIDDEN, JUST_HIDDEN])
def test_hundreds_of_half_hidden_spheres_are_not_trusted(case):
    assert campaign(Studio(), case, 200, seed=11).distrusted_share >= 0.95


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.hazard(27)
@pytest.mark.parametrize("case", [*DECEIVING, SPHERE_SIZED_GLARE], ids=lambda case: case.name)
def test_no_deceptive_image_leads_to_a_wrong_point(case):
    verdicts = deceive(Studio(), case, 150, seed=12)
    assert verdicts.wrong == 0
    assert verdicts.right + verdicts.second > verdicts.pairs // 4
