"""Looks at spheres in several orientations show the errors of the arm, and a sphere that has moved."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.journal.results import FramedPose
from procedures.registration.arm_hypotheses import at_looks
from procedures.registration.error_sources import (
    CT,
    LACKING,
    REPEATABILITY,
    SCAN,
    SEATING,
    STEREO,
    TOOL_FRAME,
)
from procedures.registration.target_prediction import AllowedErrors, IndependentErrors, SharedErrors
from procedures.steps.clinical.path_check import LocalizationPose
from procedures.steps.clinical.sphere_pairs import (
    LearnedPairs,
    LookedPairs,
)
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform

SPHERES_MM = np.array([[60.0, 0, 0], [0, 80, 10], [-70, 0, 0], [0, -60, 40], [10, 10, 90]])
TARGET_MM = np.array([5.0, -10.0, -20.0])
ROBOT_FROM_CT = Transform(
    Frame.ROBOT,
    Frame.CT,
    RigidTransform.from_components([700.0, 20.0, 250.0], Rotation.from_euler("z", 30, degrees=True)),
)
TURNS = Rotation.from_euler("xyz", [[0, 0, 0], [30, 0, 0], [0, 30, 20]], degrees=True).as_matrix()
TOOL_MM = 2.0  # one standard deviation per axis
TOOL_ERROR_MM = np.array([2.5, -1.0, 1.5])
SPHERE_MM, REST_MM, TRACKER_MM = 0.05, 0.01, 0.15


def pairs(
    noise: np.random.Generator | None = None, moved_mm: Array | None = None, moved: tuple[int, ...] = (2,)
) -> LearnedPairs:
    """Return pairs of an arm whose only error is that of its tool, each sphere seen in every orientation."""
    views = list(product(range(len(SPHERES_MM)), TURNS))
    true = SPHERES_MM.copy()
    if noise is not None:
        true += SPHERE_MM * noise.normal(size=true.shape)
    if moved_mm is not None:
        true[list(moved)] += moved_mm
    turns = np.array([turn for _, turn in views])
    rows = [sphere for sphere, _ in views]
    physical = ROBOT_FROM_CT.apply(true[rows]) - turns @ TOOL_ERROR_MM
    if noise is not None:
        physical = physical + REST_MM * noise.normal(size=physical.shape)
    pose = FramedPose.of(Transform.of(Frame.ROBOT, Frame.TOOL))
    joints = (0.0,) * 6
    small = np.tile(np.eye(3) * SPHERE_MM**2 / 2.0, (len(rows), 1, 1))
    nothing = np.zeros((3, 3))
    return LearnedPairs(
        LookedPairs(
            fiducials=tuple(rows),
            looks=tuple(
                LocalizationPose(fiducial=row, tool_pose=pose, approach_rad=joints, joints_rad=joints)
                for row in rows
            ),
            image_mm=SPHERES_MM[rows],
            physical_mm=np.asarray(physical),
            ct_mm2=small,
            seating_mm2=small,
            stereo_mm2=np.tile(np.eye(3) * 1e-6, (len(rows), 1, 1)),
            sides_mm2=np.zeros((len(rows), 3, 3)),
            tracker_mm=ROBOT_FROM_CT.apply(true[rows]),
            tracker_mm2=np.tile(np.eye(3) * TRACKER_MM**2, (len(rows), 1, 1)),
            arm_mm=0.1,
            scan=SharedErrors(SCAN, np.zeros((len(rows), 3, 1)), np.zeros((3, 1))),
            allowed=AllowedErrors(small, TOOL_MM * turns),
        ),
        (
            SharedErrors(TOOL_FRAME, TOOL_MM * turns, TOOL_MM * np.eye(3)),
            IndependentErrors(REPEATABILITY, np.tile(np.eye(3) * REST_MM**2, (len(rows), 1, 1)), nothing),
        ),
    )


def agree(some: LearnedPairs) -> bool:
    return all(one.passed for one in some.checks)


def sources_at_target(some: LearnedPairs, turn: Array) -> list[SharedErrors | IndependentErrors]:
    looked, nothing = some.looked, np.zeros((3, 3))
    tool, rest = some.errors
    assert isinstance(tool, SharedErrors)
    return [
        IndependentErrors(CT, looked.ct_mm2, nothing),
        IndependentErrors(SEATING, looked.seating_mm2, nothing),
        IndependentErrors(STEREO, looked.stereo_mm2, nothing),
        SharedErrors(tool.source, tool.at_spheres_mm, TOOL_MM * turn),
        rest,
    ]


def test_the_guide_goes_to_the_true_place_less_the_error_of_the_arm_there() -> None:
    some, turn = pairs(), Rotation.from_euler("y", -40, degrees=True).as_matrix()
    true_mm = ROBOT_FROM_CT.apply(TARGET_MM)
    assert some.fit.transform.apply(TARGET_MM) == pytest.approx(true_mm, abs=0.02)
    mapped_mm = np.asarray(some.fit.transform.apply(TARGET_MM))
    learned = some.predict(mapped_mm, sources_at_target(some, turn))
    assert mapped_mm + learned.shift_mm + turn @ TOOL_ERROR_MM == pytest.approx(true_mm, abs=0.02)


def test_what_was_learned_is_kept_sphere_by_sphere_and_target_by_target() -> None:
    some = pairs()
    mapped_mm = np.asarray(some.fit.transform.apply(TARGET_MM))
    found = some.predict(mapped_mm, sources_at_target(some, np.eye(3)))
    kept = some.learned({"T1": replace(found, shift_mm=np.array([1.0, 2.0, 3.0]))})
    assert (kept.looks, kept.fiducials) == (15, (0, 1, 2, 3, 4))
    assert np.array(kept.spheres_robot_mm) == pytest.approx(ROBOT_FROM_CT.apply(SPHERES_MM), abs=0.02)
    assert kept.corrections_mm == {"T1": (1.0, 2.0, 3.0)}
    assert kept.correction_limits_mm == {"T1": found.limit_mm}
    assert np.linalg.norm(found.shift_mm) < found.limit_mm


def test_a_moved_sphere_is_named_and_not_taken_for_an_error_of_the_arm() -> None:
    noise = np.random.default_rng(3)
    assert agree(pairs(noise))
    some = pairs(noise, moved_mm=np.array([0.0, 1.2, 0.0]))
    assert not agree(some)
    assert some.find_moved() == ((2,),)
    assert some.without(2).fiducials == (0, 1, 3, 4)
    assert agree(some.without(2))


@pytest.mark.hazard(11)
def test_with_one_look_at_each_of_four_spheres_the_tracker_shows_which_has_moved() -> None:
    every = pairs(np.random.default_rng(3), moved_mm=np.array([1.2, 0.0, 0.0]))
    rows = [0, 4, 8, 9]
    some = replace(every, looked=every.looked.at(rows), errors=tuple(at_looks(every.errors, rows)))
    in_place_mm = ROBOT_FROM_CT.apply(some.looked.image_mm)
    unseen = replace(some, looked=replace(some.looked, tracker_mm=in_place_mm))
    assert [one.checks[0].passed for one in (unseen, some)] == [True, False]
    assert some.find_moved() == ((2,),)


def test_the_prediction_has_the_spheres_the_arm_and_what_its_model_lacks() -> None:
    some = pairs(np.random.default_rng(1))
    mapped_mm = np.asarray(some.fit.transform.apply(TARGET_MM))
    found = some.predict(mapped_mm, sources_at_target(some, np.eye(3))).prediction
    assert {CT, SEATING, STEREO, TOOL_FRAME, LACKING} <= set(found.budget_mm)
    assert found.budget_mm[TOOL_FRAME] < 0.1 * TOOL_MM
    assert found.limit_mm() > found.rms_mm


def test_two_spheres_that_moved_together_are_not_taken_for_a_third() -> None:
    some = pairs(np.random.default_rng(3), moved_mm=np.array([0.85, 0.85, 0.0]), moved=(0, 1))
    assert not agree(some)
    assert some.find_moved() == ((0, 1),)


def test_two_spheres_that_the_gate_lets_pass_are_named_in_the_budget_and_widen_the_limit() -> None:
    quiet, moved = (
        pairs(np.random.default_rng(3), moved_mm=moved_mm, moved=(0, 3))
        for moved_mm in (None, np.array([0.032, -0.024, 0.02]))
    )
    assert agree(moved)
    before, after = (
        one.predict(
            np.asarray(one.fit.transform.apply(TARGET_MM)), sources_at_target(one, np.eye(3))
        ).prediction
        for one in (quiet, moved)
    )
    named = "spheres 1 and 4 moved together"
    assert set(after.budget_mm) - set(before.budget_mm) == {named}
    assert 0.05 < after.budget_mm[named] < 0.5
    assert after.limit_mm() > before.limit_mm() + after.budget_mm[named]
