"""One pairing by the thesis' similarity matrix, in the form of the other matchers."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from procedures.engine.methods import CaseMethods
from procedures.registration.correspondence import Match, MatchStatus
from procedures.registration.errors import BadParameter
from procedures.registration.thesis_matching import match_as_thesis
from procedures.registration.thesis_settings import (
    E_RANGE_MM,
    REFUSED_SHARE,
    REFUSED_SHARE_RANGE,
    THESIS_TOLERANCES_MM,
)

SIGMAS = {"sigma_image_mm": 0.1, "sigma_physical_mm": 0.35}
NAN, INF = float("nan"), float("inf")


def paired(image, physical, **changes) -> Match:
    return match_as_thesis(
        image, physical, **({"e_mm": 2.5, "refused_share": REFUSED_SHARE} | SIGMAS | changes)
    )


def test_a_pairing_is_ordered_by_image_point_and_brings_its_transform(random, fiducials, reading):
    seen = reading(fiducials(6, random), 2, random)
    found = paired(seen.image_mm, seen.physical_mm, e_mm=3.0, sigma_physical_mm=0.6)
    assert found.status is MatchStatus.UNIQUE
    assert {(int(i), int(j)) for i, j in found.pairs} == seen.pairs
    assert found.pairs[:, 0].tolist() == sorted(found.pairs[:, 0].tolist())
    mapped = found.require_unique().apply(seen.image_mm[found.pairs[:, 0]])
    assert np.linalg.norm(mapped - seen.physical_mm[found.pairs[:, 1]], axis=1).max() < 3.0
    assert len(found.unmatched_image) == len(found.unmatched_physical) == 2
    assert (found.margin_nats, found.runner_up) == (None, None)  # no odds are stated


@pytest.mark.parametrize(
    ("expected", "status", "reason"),
    [
        (5, MatchStatus.UNIQUE, "5 pairs agree within e = 2.5 mm"),
        (None, MatchStatus.UNIQUE, "5 pairs agree within e = 2.5 mm"),
        (
            4,
            MatchStatus.AMBIGUOUS,
            "within e = 2.5 mm more than 4 spheres agree, or some with more than one partner",
        ),
        (6, MatchStatus.TOO_FEW, "5 image and 5 physical points, 6 needed"),
    ],
)
def test_another_number_than_the_planned_one_is_refused(random, fiducials, expected, status, reason):
    head = fiducials(5, random)
    found = paired(head, head, expected=expected)
    assert (found.status, found.reason) == (status, reason)


def test_a_pairing_with_residuals_beyond_the_noise_says_so(random, fiducials):
    head = fiducials(5, random)
    found = paired(head, 1.01 * head, sigma_physical_mm=0.05)
    assert found.status is MatchStatus.INCONSISTENT
    assert found.reason.endswith("with residuals beyond the noise")


def test_points_on_a_line_determine_no_rotation():
    line = np.outer([0.0, 20.0, 55.0, 100.0], [1.0, 0.0, 0.0])
    found = paired(line, line)
    assert found.status is MatchStatus.INCONSISTENT
    assert "collinear" in found.reason


@pytest.mark.parametrize(
    ("setting", "said", "values"),
    [
        ("e_mm", r"REG-007: e .*; limit 1 to 6 mm, got {:g} mm\. Give ", [0.0, -1.0, 0.99, 6.01, NAN, INF]),
        (
            "refused_share",
            r"share .*; limit 1e-06 to 0\.5, got {:g}\. Give ",
            [0.0, 1e-7, 0.51, 1.0, 2.0, NAN],
        ),
    ],
)
def test_a_setting_that_the_thesis_did_not_try_is_refused_by_matcher_and_case(
    random, fiducials, setting, said, values
):
    head = fiducials(5, random)
    for value in values:
        for refused in (partial(paired, head, head), CaseMethods):
            with pytest.raises(BadParameter, match=said.format(value)):
                refused(**{setting: value})


def test_the_ends_of_the_ranges_are_settings_of_a_case():
    for e_mm, share in zip(E_RANGE_MM, REFUSED_SHARE_RANGE, strict=True):
        assert CaseMethods(e_mm=e_mm, refused_share=share).e_mm == e_mm
    assert (THESIS_TOLERANCES_MM[0], THESIS_TOLERANCES_MM[-1]) == E_RANGE_MM
    assert len(THESIS_TOLERANCES_MM) == 51
    assert CaseMethods().e_mm in THESIS_TOLERANCES_MM
