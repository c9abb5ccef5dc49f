"""Malformed input raises a one-line RonnaError that is also a ValueError."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from coded_errors import raises

from procedures.registration import (
    find_layout,
    match,
    match_by_template,
    register,
    register_clouds,
    verify_two_way,
)
from procedures.registration.errors import (
    BAD_COVARIANCE,
    BAD_POINTS,
    DUPLICATE_POINTS,
    NOT_CONVERGED,
    TOO_FEW_POINTS,
    BadParameter,
    CollinearPoints,
)
from procedures.registration.rigid_fit import fit_weighted
from ronna_hw.errors import RonnaError
from ronna_hw.frames import FRAME_MISMATCH, UNKNOWN_FRAME, Frame, Transform

GOOD = np.array([[0, 0, 0], [80, 0, 0], [0, 90, 0], [10, 20, 70]], dtype=float)
LINE = np.outer([0.0, 30.0, 70.0, 100.0], [1.0, 2.0, 3.0])
UNIT = np.tile(np.eye(3), (4, 1, 1))
NOT_REAL = (complex, object, bool, str)


def with_value(row: int, value: float) -> np.ndarray:
    points = GOOD.copy()
    points[row, 1] = value
    return points


TAKERS_OF_POINTS = {
    "match": partial(match, sigma_image_mm=0.17, sigma_physical_mm=0.56),
    "register": register,
    "register_clouds": register_clouds,
}


@pytest.mark.parametrize("taker", TAKERS_OF_POINTS)
@pytest.mark.parametrize(
    ("bad", "said"),
    [
        *((bad, "") for bad in (np.full((4, 3), np.nan), np.zeros((4, 2)), np.zeros(6), [[1, 2], [3]], None)),
        *((GOOD.astype(kind), ".*not real numbers") for kind in NOT_REAL),
    ],
)
def test_malformed_points_raise_a_one_line_error(taker, bad, said):
    for pair in ((bad, GOOD), (GOOD, bad)):
        with raises(BAD_POINTS, match=f"REG-001{said}") as caught:
            TAKERS_OF_POINTS[taker](*pair)
        assert isinstance(caught.value, ValueError)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("image", "physical", "error"),
    [
        (with_value(1, np.nan), GOOD, BAD_POINTS),
        (GOOD, with_value(2, np.inf), BAD_POINTS),
        (GOOD, with_value(2, 1e9), BAD_POINTS),
        (GOOD, GOOD[None], BAD_POINTS),
        (GOOD, GOOD[:3], BAD_POINTS),
        ("points", GOOD, BAD_POINTS),
        ([], [], TOO_FEW_POINTS),
        (GOOD[:2], GOOD[:2], TOO_FEW_POINTS),
        (LINE, LINE, CollinearPoints),
        (GOOD, LINE, CollinearPoints),
        (np.vstack([GOOD, GOOD[:1] + 1.0]), np.vstack([GOOD, GOOD[:1] + 50.0]), DUPLICATE_POINTS),
        (np.vstack([GOOD, GOOD[:1] + 50.0]), np.vstack([GOOD, GOOD[:1]]), DUPLICATE_POINTS),
        (np.zeros((4, 3)), np.zeros((4, 3)), DUPLICATE_POINTS),
    ],
)
def test_bad_points_are_refused(image, physical, error):
    with raises(error) as caught:
        register(image, physical)
    assert isinstance(caught.value, ValueError)
    assert isinstance(caught.value, RonnaError)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(caught.value.code)


@pytest.mark.parametrize(
    ("covariance", "said"),
    [
        (np.eye(3), ""),
        (UNIT[:3], ""),
        (UNIT * np.nan, ""),
        (UNIT * 0.0, ""),
        (-UNIT, ""),
        (UNIT + np.triu(np.ones((3, 3)), 1), ""),
        (UNIT * np.diag([1.0, 1.0, -0.5]), ""),
        ("isotropic", ""),
        *((UNIT.astype(kind), ".*not real numbers") for kind in NOT_REAL),
    ],
)
def test_bad_covariances_are_refused(covariance, said):
    with raises(BAD_COVARIANCE, match=f"REG-005{said}") as caught:
        register(GOOD, GOOD, covariance_mm2=covariance)
    assert isinstance(caught.value, ValueError)


def test_targets_are_checked_like_fiducials():
    with raises(BAD_POINTS, match="REG-001"):
        register(GOOD, GOOD).predict_tre_mm([[0.0, np.nan, 0.0]])


def test_a_weighted_fit_that_does_not_converge_is_reported(monkeypatch):
    monkeypatch.setattr("procedures.registration.rigid_fit.MOST_STEPS", 1)
    with raises(NOT_CONVERGED, match="REG-006"):
        fit_weighted(GOOD, GOOD @ np.diag([1.0, 1.1, 0.9]) + 5.0, UNIT, np.eye(3), np.zeros(3))


def test_two_sets_in_different_units_are_refused_before_a_fit_of_them_does_not_converge():
    with raises(BAD_POINTS, match=r"1000 times as far apart .* Are the physical points in metres\?"):
        register(GOOD * 1000.0, GOOD, covariance_mm2=UNIT)


@pytest.mark.parametrize(("image", "physical"), [(GOOD / 1000.0, GOOD), (GOOD, GOOD / 1000.0)])
def test_the_refusal_of_very_small_points_asks_whether_they_are_metres(image, physical):
    with raises(DUPLICATE_POINTS, match=r"REG-004: .* are these metres\?"):
        register(image, physical)


def test_a_transform_may_be_given_with_frames_or_as_a_matrix():
    fit = register(GOOD, GOOD)
    named = fit.between(Frame.TRACKER, Frame.CT)
    expected = verify_two_way(GOOD, GOOD, [(0, 0), (1, 1)], fit.transform)
    assert verify_two_way(GOOD, GOOD, [(0, 0), (1, 1)], named) == expected
    assert verify_two_way(GOOD, GOOD, [(0, 0), (1, 1)], named.as_matrix()) == expected
    assert register_clouds(GOOD, GOOD, start=named.as_matrix()).residual_mm < 1e-9


@pytest.mark.parametrize(
    "transform", [np.eye(3), 2.0 * np.eye(4), np.diag([-1.0, 1.0, 1.0, 1.0]), "T", [[1.0], [1.0, 2.0]]]
)
def test_what_is_no_rigid_transform_is_refused(transform):
    with pytest.raises(BadParameter, match="is no rigid transform"):
        verify_two_way(GOOD, GOOD, [(0, 0)], transform)


def test_frames_may_be_named_by_words_and_a_misspelt_one_is_refused():
    fit = register(GOOD, GOOD)
    assert (Transform.of("robot", "ct") @ fit.between(Frame.CT, "robot")).source is Frame.ROBOT
    for build in (fit.between, Transform.of):
        with raises(UNKNOWN_FRAME, match="'robt'"):
            build("robt", Frame.CT)


def test_a_layout_of_two_spheres_is_refused():
    with raises(TOO_FEW_POINTS, match=r"2 sphere\(s\) of a layout given"):
        find_layout(GOOD[:2], GOOD)
    with raises(TOO_FEW_POINTS, match=r"2 point\(s\) of a template given"):
        match_by_template(GOOD[:2], GOOD, GOOD, sigma_image_mm=0.1, sigma_physical_mm=0.1)


def test_a_number_given_as_text_is_shown_as_text():
    with pytest.raises(BadParameter, match=r"got '0\.05'"):
        match(GOOD, GOOD, sigma_image_mm="0.05", sigma_physical_mm=0.1)
    with pytest.raises(BadParameter, match="at least 3: '5'"):
        match(GOOD, GOOD, sigma_image_mm=0.1, sigma_physical_mm=0.1, expected="5")


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
def test_a_quaternion_that_is_no_rotation_is_refused(quaternion):
    with raises(FRAME_MISMATCH, match="is no rotation"):
        Transform.of(Frame.ROBOT, Frame.CT, quaternion_wxyz=quaternion)


def test_points_of_another_shape_are_refused_by_a_transform():
    with raises(FRAME_MISMATCH, match=r"shape \(1, 4\)"):
        Transform.of(Frame.ROBOT, Frame.CT).apply([[1.0, 2.0, 3.0, 1.0]])
