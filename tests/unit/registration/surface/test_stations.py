"""The error of a scan is expected before it is made, and its looks are chosen by it."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises

from procedures.registration.surface.errors import BAD_SURFACE_INPUT, LITTLE_COVERAGE
from procedures.registration.surface.misfit import Misfit, Roughness
from procedures.registration.surface.stations import Station, choose_stations, expect_error

LOOKS = {
    "front": (0.0, -1.0, 0.2),
    "left": (1.0, -0.6, 0.2),
    "right": (-1.0, -0.6, 0.2),
    "forehead": (0.0, -0.7, 1.0),
    "vault": (0.0, 0.0, 1.0),
}
TARGETS_MM = np.array([[-20.0, -20.0, -20.0], [20.0, 10.0, 25.0], [0.0, 40.0, 0.0]])
SMOOTH = {Misfit(0.3, 20.0, Roughness.SMOOTH): 1.0}


def seen(head, *names):
    """Points of the head that looks from these directions show."""
    facing = np.zeros(len(head.points_mm), dtype=bool)
    for name in names:
        direction = np.array(LOOKS[name]) / np.linalg.norm(LOOKS[name])
        facing |= head.normals @ direction > 0.5
    return head.points_mm[facing], head.normals[facing]


def rms(predictions):
    return float(np.sqrt(np.mean([one.rms_mm**2 for one in predictions])))


def test_front_and_ears_beat_the_forehead_with_the_vault_and_the_face_alone(heads):
    whole, vault, face = (
        rms(expect_error(*seen(heads[0], *names), TARGETS_MM, misfits=SMOOTH))
        for names in (("front", "left", "right", "forehead"), ("forehead", "vault"), ("front",))
    )
    assert whole < 0.9 * vault
    assert whole < 0.9 * face


def test_the_limit_contains_more_than_the_rms(heads):
    for one in expect_error(*seen(heads[0], "front", "left"), TARGETS_MM):
        assert one.rms_mm < one.limit_mm() < 3.0 * one.rms_mm


def test_looks_are_chosen_by_what_they_add(heads):
    candidates = [Station(*seen(heads[0], name), seconds=2.0) for name in LOOKS]
    choice = choose_stations([*candidates, candidates[0]], TARGETS_MM)
    assert list(choice.rms_mm) == sorted(choice.rms_mm, reverse=True)
    assert 5 not in choice.stations[:-1]  # the same look twice adds next to nothing
    assert {1, 2} <= set(choice.stations)  # both sides


def test_a_look_that_takes_long_is_not_worth_it(heads):
    front, left = (Station(*seen(heads[0], name), seconds=1e4) for name in ("front", "left"))
    assert len(choose_stations([front, left], TARGETS_MM).stations) == 1


def test_what_shows_nothing_is_refused(heads):
    nothing = Station(np.zeros((0, 3)), np.zeros((0, 3)), 5.0)
    with raises(LITTLE_COVERAGE):
        choose_stations([nothing], TARGETS_MM)
    with raises(LITTLE_COVERAGE):
        expect_error(np.zeros((3, 3)), np.zeros((3, 3)), TARGETS_MM)
    with raises(BAD_SURFACE_INPUT):
        expect_error(heads[0].points_mm, heads[0].normals[:5], TARGETS_MM)


@pytest.mark.parametrize("roughness", Roughness)
def test_points_at_one_place_share_their_misfit(roughness):
    covariance = Misfit(0.3, 20.0, roughness).covariance_mm2(np.array([0.0, 20.0, 500.0]), np.ones(3))
    assert covariance[0] == pytest.approx(0.09)
    assert 0.2 < covariance[1] / 0.09 < 0.6
    assert covariance[2] < 1e-6


def test_skin_that_moved_as_one_went_in_on_one_side_and_out_on_the_other():
    sagged = Misfit(0.3, 100.0, Roughness.SMOOTHER, is_sagging=True)
    same, across, opposite = sagged.covariance_mm2(np.full(3, 50.0), np.array([1.0, 0.0, -1.0]))
    assert same > 0.0
    assert across == 0.0
    assert opposite == -same
