"""A registration that learns the arm: its corrections and a sphere that may have moved have limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clinical_case import FIRST, SPHERES_MM, ClinicalCell
from coded_errors import raises
from prepared_results import (
    checked_paths,
    checked_plan,
    coarse,
    localized_fiducials,
    looks_with_tool_error,
)
from watched_case import findings

from procedures.journal.errors import GateFailed
from procedures.operator.question import Question, Topic
from procedures.registration.arm_learning import LearnedTarget
from procedures.registration.target_prediction import TargetPrediction
from procedures.steps.clinical import registration
from procedures.steps.clinical.registration import STEP, tell_learned
from procedures.steps.clinical.results import RegisteredRobot
from procedures.strategies.catalogue import find_strategy
from procedures.workcell import MountedTool
from ronna_hw.arrays import Array

TOOL_ERROR_MM = np.array([0.2, -0.1, 0.1])
MOVED_MM = np.array([1.2, -1.2, 1.2])
NARROW_MM = 0.8  # above the predicted rms, below what one moved sphere may do


def asked_of_first(cell: ClinicalCell) -> list[Question]:
    return [one for one in cell.operator.asked if one.name == f"{Topic.REGISTRATION}:{FIRST}"]


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path, strategy=find_strategy("learning")).carrying(MountedTool.STEREO_HEAD)


def learned(cell: ClinicalCell, spheres_mm: Array = SPHERES_MM, **plan_changes: object) -> RegisteredRobot:
    """Register by the looks of an arm whose tool is a little off its record."""
    paths = checked_paths(cell)
    checked, measured = looks_with_tool_error(paths, TOOL_ERROR_MM, spheres_mm)
    before = (*coarse(), checked_plan(**plan_changes), localized_fiducials(), measured)
    cell.run(*before, checked, STEP)
    return cell.case.get(RegisteredRobot).result


def test_the_operator_sees_what_was_learned_beside_its_limits(cell: ClinicalCell) -> None:
    done = learned(cell)
    (accepted,) = asked_of_first(cell)
    assert done.learned is not None
    assert f"{done.learned.share:.0%} of their stated size, at most 290%" in accepted.value
    assert f"at most {done.learned.correction_limits_mm[FIRST]:.2f} mm" in accepted.value


def test_sizes_of_the_arm_that_were_not_estimated_are_not_told(cell: ClinicalCell) -> None:
    known = learned(cell).learned
    assert known is not None
    told = tell_learned(known.model_copy(update={"share": None, "scatter_mm": None}), FIRST)
    assert "%" not in told
    assert f"at most {known.correction_limits_mm[FIRST]:.2f} mm" in told


def with_moved(sphere: int) -> Array:
    moved_mm = SPHERES_MM.copy()
    moved_mm[sphere] += MOVED_MM
    return moved_mm


@pytest.mark.hazard(11)
@pytest.mark.branch("MOVED_SPHERE")
def test_a_moved_sphere_is_left_out_by_name_and_not_taken_for_a_bad_arm(cell: ClinicalCell) -> None:
    done = learned(cell, with_moved(2))
    question = cell.operator.asked[0]
    assert "Sphere 3 disagrees with all others" in question.subject
    assert "probability that a sphere has moved 100% with it" in question.value
    assert [one.fiducial for one in done.left_out_spheres] == [2]


@pytest.mark.hazard(11)
def test_where_two_spheres_may_each_have_moved_the_registration_is_refused_by_both_names(
    cell: ClinicalCell,
) -> None:
    with raises(GateFailed, match=r"limit 50%, got 100%. One of these has moved: sphere 1 or 2\. Check them"):
        learned(cell, with_moved(1))


@pytest.mark.hazard(11)
def test_a_bound_of_a_moved_sphere_beyond_the_margin_is_a_finding_and_confirmed_by_itself(
    cell: ClinicalCell,
) -> None:
    done = learned(cell, margin_mm=NARROW_MM)
    bound_mm = done.predictions[0].moved_sphere_mm
    assert bound_mm is not None
    assert bound_mm > NARROW_MM
    confirmed, _accepted = asked_of_first(cell)
    assert f"off by {bound_mm:.2f} mm" in confirmed.value
    assert any(f"off by {bound_mm:.2f} mm" in one for one in findings(cell))


@pytest.mark.hazard(67)
@pytest.mark.branch("CORRECTION_BEYOND")
def test_a_correction_longer_than_errors_of_the_arm_explain_is_refused() -> None:
    unlike = LearnedTarget(np.array([6.0, 0.0, 0.0]), TargetPrediction({}), limit_mm=5.0)
    with raises(GateFailed, match="limit 5.00 mm, got 6.00 mm"):
        registration.require_explained_corrections({FIRST: unlike})


def test_every_sphere_that_may_have_moved_is_named() -> None:
    advice = registration._advise_on_moved([[1], [0], [1, 3]], 5)
    assert advice == "One of these has moved: sphere 2, 1 or 2 with 4. Check them, then localize again."
