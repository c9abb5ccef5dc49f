"""First looks at the skin: the head is found by them alone, and refused where nobody measured it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.engine.context import StepContext
from procedures.planning.skin_views import spread_rows
from procedures.registration.errors import HeadElsewhere
from procedures.registration.surface.errors import FAR_FROM_START, HEAD_MOVED, NO_STATIONS, NOTHING_LIT
from procedures.registration.surface.starts import Start
from procedures.steps.clinical.correspondence import MeasuredHead
from procedures.steps.clinical.surface.head_measurement import BY_TAPE
from procedures.steps.clinical.surface.repeated_work import repeat_if_refused
from procedures.steps.clinical.surface.surface_survey import MEASURE_HEAD_AGAIN, VIEWS, find_head
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform

TARGETS_MM = np.array([[-20.0, -20.0, -20.0], [0.0, 40.0, 0.0]])
LANDMARKS_MM = np.array([[0.0, -115.0, -48.0], [88.0, 12.0, -42.0], [-88.0, 12.0, -42.0]])
TAPE_MM = np.array([[12.0, -9.0, 14.0], [-11.0, 8.0, 10.0], [6.0, 14.0, -12.0]])  # a slip for each landmark
PATCH_MM = 15.0  # of the skin around the middle of a look


def allow(objection=""):
    sight = SimpleNamespace(centre_mm=np.zeros(3))
    return SimpleNamespace(sight=sight, check_position=lambda _rotation, _middle_mm: objection)


@pytest.fixture(scope="module")
def looked(heads, scan_of):
    """Patches of a scan that are as large as what a look shows, and as many."""
    made = scan_of(heads[0], 41, count=1000, misfit_mm=0.3)
    places = made.truth.inverse().apply(made.scan.points_mm)
    middles = places[spread_rows(places, VIEWS)]
    near = np.linalg.norm(places[:, None] - middles, axis=2).min(axis=1) < PATCH_MM
    return made, made.scan.select(near)


def measure(truth: Transform) -> Start:
    return Start.from_landmarks(LANDMARKS_MM, truth.apply(LANDMARKS_MM) + TAPE_MM, BY_TAPE.deviation_mm)


def test_a_few_looks_find_the_head_that_was_measured_to_a_centimetre(heads, looked):
    made, scan = looked
    found = find_head(scan, heads[0], measure(made.truth), TARGETS_MM, allow())
    away_mm = np.linalg.norm(found.robot_from_ct.apply(TARGETS_MM) - made.truth.apply(TARGETS_MM), axis=1)
    assert away_mm.max() < 2.0


def test_a_head_that_was_measured_elsewhere_is_refused(heads, looked):
    made, scan = looked
    turned = RigidTransform.from_rotation(Rotation.from_rotvec([0.0, 0.0, np.pi]))
    elsewhere = Transform(made.truth.target, made.truth.source, made.truth.rigid * turned)
    with raises(FAR_FROM_START):
        find_head(scan, heads[0], measure(elsewhere), TARGETS_MM, allow())


def test_a_head_that_the_plan_has_otherwise_is_refused(heads, looked):
    made, scan = looked
    with pytest.raises(HeadElsewhere, match="by the first looks the head would be turned"):
        find_head(scan, heads[0], measure(made.truth), TARGETS_MM, allow("the head would be turned"))


def void_after(problem: RonnaError) -> list[type]:
    """Have first looks fail; return the models whose results are void."""
    gone: list[type] = []
    context = cast(StepContext, SimpleNamespace(void_each=lambda model, _reason: gone.append(model)))
    with pytest.raises(RonnaError) as failed, repeat_if_refused(context, MEASURE_HEAD_AGAIN):
        raise problem
    assert failed.value.code == problem.code
    assert problem.summary in str(failed.value)
    assert ("measured again" in failed.value.advice) == bool(gone)
    return gone


@pytest.mark.branch("HEAD_NOT_FOUND")
@pytest.mark.parametrize(
    "problem",
    [FAR_FROM_START("far"), NO_STATIONS("few looks", got="3"), NOTHING_LIT("dark"), HeadElsewhere("turned")],
    ids=lambda one: one.code,
)
def test_where_the_head_is_not_found_it_is_measured_again(problem):
    assert void_after(problem) == [MeasuredHead]


def test_a_head_that_moved_meanwhile_was_not_measured_wrongly():
    assert void_after(HEAD_MOVED("the looks disagree")) == []
