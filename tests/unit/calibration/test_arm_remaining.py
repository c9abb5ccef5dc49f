"""What an identification leaves, with its correlations: in the record, and at a target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from arm_looks import KINEMATICS, SPHERES_MM, LookingArm

from procedures.calibration.arm_calibration import ArmResult, calibrate_arm
from procedures.calibration.arm_sources import ArmPoses, arm_sources, identified_errors
from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.target_prediction import TargetPrediction, allow_for, predict_target_error
from procedures.runs.calibrations import ARM
from ronna_hw.arrays import Array
from ronna_hw.bounded_input import parse_toml
from ronna_hw.calibrated_arm.deviations import ArmDeviations, flange_poses, flange_rotations, gravity_levers
from ronna_hw.calibrated_arm.error_budget import ErrorSizes, IdentifiedArm, by_deviation
from ronna_hw.calibration import ArmCalibration
from ronna_hw.config import ProcedureSettings

CHAIN = KINEMATICS.chain
TURNS = np.array([[0.0, 0, 0], [0.1, -0.1, 0.2], [-0.2, 0.1, 0.1], [0.1, 0.2, -0.2], [-0.1, -0.1, 0.0]])
TURNED = np.array([[0.3, -0.5, 0.4], [-0.2, 0.6, 0.2], [0.4, 0.3, -0.7], [-0.6, 0.2, 0.5], [0.2, 0.4, 0.6]])
JOINTS = np.array(KINEMATICS.home_rad) + np.hstack([TURNS, TURNED])  # four spheres, then the target
SIDES = np.where(np.arange(30).reshape(5, 6) % 3 == 0, -1.0, 1.0)
LEVERS = gravity_levers(CHAIN, JOINTS)
TOOL_MM = np.array([220.0, 0.0, 60.0])
NOMINAL = flange_poses(CHAIN, ArmDeviations.none(6), JOINTS)
POINTS_MM = NOMINAL[:, :3, :3] @ TOOL_MM + NOMINAL[:, :3, 3]


@pytest.fixture(scope="module")
def result() -> ArmResult:
    return calibrate_arm(LookingArm.of(3).looks(90, 24, SPHERES_MM))


def predicted(sizes: ErrorSizes, sides: Array | None) -> TargetPrediction:
    sources = arm_sources(
        CHAIN,
        ArmPoses(JOINTS[:4], POINTS_MM[:4], None if sides is None else sides[:4]),
        ArmPoses(JOINTS[4:], POINTS_MM[4:], SIDES[4:]),
        sizes,
        servo_mm=0.0,
    )
    return predict_target_error(POINTS_MM[:4], POINTS_MM[4], sources)


def test_every_deviation_displaces_the_tool_as_it_does_in_the_model_of_the_arm() -> None:
    found, nominal = by_deviation(CHAIN, JOINTS, POINTS_MM, SIDES), ArmDeviations.none(6).flat()
    for number, step in enumerate(1e-6 * np.eye(len(nominal))):
        poses = flange_poses(CHAIN, ArmDeviations.from_flat(nominal + step, 6), JOINTS, SIDES)
        moved = (poses[:, :3, :3] @ TOOL_MM + poses[:, :3, 3] - POINTS_MM) / 1e-6
        np.testing.assert_allclose(found[:, :, number], moved, atol=2e-3)  # mm per rad: of 700
    np.testing.assert_array_equal(found[:, :, -3:], flange_rotations(CHAIN, JOINTS))


def test_what_the_fit_has_learnt_is_no_longer_free_to_tell_the_random_error(result: ArmResult) -> None:
    measured, spheres = 3 * int(result.fit.used.sum()), 3 * len(SPHERES_MM)
    assert measured - spheres - result.fit.model.size < result.arm.freedom < measured - spheres
    known = IdentifiedArm.of(result.arm)
    assert known is not None
    assert known.freedom == result.arm.freedom


def test_a_gate_allows_for_the_errors_of_an_identified_arm_that_the_prediction_counts(
    result: ArmResult,
) -> None:
    known = IdentifiedArm.of(result.arm)
    assert known is not None
    spheres = ArmPoses(JOINTS[:4], POINTS_MM[:4], SIDES[:4])
    target = ArmPoses(JOINTS[4:], POINTS_MM[4:], SIDES[4:])
    counted = allow_for(arm_sources(CHAIN, spheres, target, ErrorSizes(identified=known), servo_mm=0.0), 4)
    allowed = identified_errors(CHAIN, spheres, known)
    np.testing.assert_allclose(allowed.independent_mm2, counted.independent_mm2)
    np.testing.assert_allclose(allowed.shared_mm, counted.shared_mm)
    assert allowed.freedom == known.freedom


def test_the_record_holds_the_covariance_of_the_fit_in_its_own_units(result: ArmResult) -> None:
    known = IdentifiedArm.of(result.arm)
    assert known is not None
    fit, own = result.fit, result.fit.model.to_record
    of_fit = own @ fit.covariance[: fit.model.size, : fit.model.size] @ own.T
    sigma = np.sqrt(np.diag(of_fit))
    np.testing.assert_allclose(np.linalg.norm(known.remaining, axis=1), sigma, rtol=1e-4)
    scale = np.where(sigma > 0.0, sigma, 1.0)
    left = (known.remaining @ known.remaining.T - of_fit) / np.outer(scale, scale)
    assert np.abs(left).max() < 1e-3
    np.testing.assert_allclose(known.backlash_rad, fit.deviations.backlash_rad)


def test_the_record_survives_a_file_of_sane_size_unchanged(result: ArmResult) -> None:
    text = tomli_w.dumps(ARM.records_of(result)["arm"])
    assert len(text) < 60_000
    assert text.count("\n") < 250
    read = {name: _tuples(value) for name, value in parse_toml(text).items()}
    assert ArmCalibration.model_validate(read) == result.arm
    assert ArmCalibration.model_validate_json(result.arm.model_dump_json()) == result.arm


def _tuples(value: object) -> object:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _drawn_errors_mm(known: IdentifiedArm, sides: Array | None, draws: int) -> Array:
    """Where arms of this covariance bring the tool beside the target, by a registration with the spheres."""
    generator = np.random.default_rng(5)
    drawn = known.remaining @ generator.normal(size=(len(known.remaining), draws))
    errors = np.zeros((draws, 3))
    for number, off in enumerate(drawn.T):
        rest = SIDES.copy()
        if sides is None:  # the head is on a side that nobody knows; the arm is taken as in the middle
            rest[:4] = generator.choice((-1.0, 1.0), size=(4, 6))
        at = off[:-3].copy()
        moved = by_deviation_of(at, rest, TOOL_MM + off[-3:]) - POINTS_MM
        if sides is None:
            at[:] = 0.0
            at[-6:] = known.backlash_rad
            whole = by_deviation_of(at, rest, TOOL_MM) - POINTS_MM
            at[-6:] = off[-9:-3]
            own = by_deviation_of(np.r_[np.zeros(72), at[-6:]], rest, TOOL_MM) - POINTS_MM
            moved[:4] += whole[:4] - own[:4]
        moved += generator.normal(0.0, known.scatter_mm, moved.shape)
        fit = fit_rigid(POINTS_MM[:4], POINTS_MM[:4] - moved[:4])
        errors[number] = fit.rotation @ POINTS_MM[4] + fit.translation_mm + moved[4] - POINTS_MM[4]
    return errors


def by_deviation_of(flat: Array, sides: Array, tool_mm: Array) -> Array:
    """Places (5, 3) mm of a tool on the flange of an arm with these deviations."""
    poses = flange_poses(CHAIN, ArmDeviations.from_flat(flat, 6), JOINTS, sides, LEVERS)
    return np.asarray(poses[:, :3, :3] @ tool_mm + poses[:, :3, 3])


@pytest.mark.parametrize("draws", [700, pytest.param(1500, marks=pytest.mark.slow)])  # an rms to 4 or 3 %
@pytest.mark.parametrize(
    "sides",
    [pytest.param(SIDES, id="known sides"), pytest.param(None, id="unknown sides", marks=pytest.mark.slow)],
)
def test_the_predicted_error_is_that_of_arms_drawn_with_the_covariance(
    result: ArmResult, sides: Array | None, draws: int
) -> None:
    sizes = ErrorSizes.stated(ProcedureSettings(), result.arm)
    assert sizes.identified is not None
    errors, found = _drawn_errors_mm(sizes.identified, sides, draws), predicted(sizes, sides)
    drawn_mm2 = errors.T @ errors / draws
    np.testing.assert_allclose(found.covariance_mm2, drawn_mm2, atol=0.06 * np.trace(drawn_mm2))
    assert found.rms_mm == pytest.approx(np.sqrt(np.trace(drawn_mm2)), rel=0.04)
    assert found.mark_contained(errors).mean() == pytest.approx(0.95, abs=0.015)


def test_correlations_leave_far_less_than_independent_errors_of_the_same_sizes(result: ArmResult) -> None:
    known = IdentifiedArm.of(result.arm)
    assert known is not None
    alone = replace(known, remaining=np.diag(np.linalg.norm(known.remaining, axis=1)))
    apart, together = (predicted(ErrorSizes(identified=one), SIDES).rms_mm for one in (alone, known))
    assert apart > 5.0 * together


def test_a_record_without_covariance_is_predicted_by_its_sizes_as_before(result: ArmResult) -> None:
    old = result.arm.model_copy(update={"remaining": None})
    sizes = ErrorSizes.stated(ProcedureSettings(), old)
    assert sizes.identified is None
    assert set(predicted(sizes, SIDES).by_source_mm2) == {
        *("links and joint offsets", "harmonics and sag", "backlash", "repeatability", "tool frame")
    }
    assert sizes == replace(ErrorSizes.stated(ProcedureSettings(), result.arm), identified=None)


def test_only_what_the_identification_leaves_and_the_random_error_are_in_the_budget(
    result: ArmResult,
) -> None:
    sizes = ErrorSizes.stated(ProcedureSettings(), result.arm)
    budget = predicted(sizes, SIDES).budget_mm
    assert set(budget) == {"arm and tool frame as identified", "repeatability"}
    assert set(predicted(sizes, None).budget_mm) == {*budget, "backlash"}
    worse = result.arm.model_copy(update={"scatter_mm": 2.0 * result.arm.scatter_mm})
    rougher = predicted(ErrorSizes.stated(ProcedureSettings(), worse), SIDES).budget_mm
    assert rougher["repeatability"] == pytest.approx(2.0 * budget["repeatability"])
