"""Which arm errors count, given what is known of its joints and its looks."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from numpy.typing import NDArray

from procedures.calibration.arm_sources import REPEATABILITY_MM, ArmPoses, arm_sources
from procedures.registration.target_prediction import IndependentErrors, SharedErrors, predict_target_error
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.pose import radians6
from ronna_hw.calibrated_arm.deviations import ArmDeviations, joint_errors
from ronna_hw.calibrated_arm.error_budget import (
    BACKLASH_RAD,
    HARMONIC_RAD,
    LINK_TRANSLATION_MM,
    SAG_RAD,
    UNCALIBRATED,
    UNCALIBRATED_MM,
    ErrorSizes,
    arm_error_mm,
    displacements,
)
from ronna_hw.calibration import ArmCalibration
from ronna_hw.config import ProcedureSettings

KR6 = kr6_r900(SIXX)
NOW = datetime(2026, 11, 22, tzinfo=UTC)
LOOKS = np.array([radians6(10.0 * k, -75.0 + 3.0 * k, 99.0, 5.0, 66.0, 180.0) for k in range(5)])
POINTS_MM = np.array([KR6.flange_pose(tuple(one)).apply((220.0, 0.0, 60.0)) for one in LOOKS.tolist()])
KNOWN, CALIBRATED = np.ones((1, 6)), ErrorSizes(tool_mm=0.1, links=0.16, joints=0.16, backlash=0.1)


def budget_mm(
    sizes: ErrorSizes, at_spheres: NDArray[np.float64] | None, servo_mm: float = 0.03
) -> dict[str, float]:
    """At the last of the poses, registered by the others."""
    sides = None if at_spheres is None else np.repeat(at_spheres, 4, axis=0)
    sources = arm_sources(
        KR6.chain,
        ArmPoses(LOOKS[:-1], POINTS_MM[:-1], sides),
        ArmPoses(LOOKS[-1:], POINTS_MM[-1:], KNOWN),
        sizes,
        servo_mm,
    )
    return predict_target_error(POINTS_MM[:-1], POINTS_MM[-1], sources).budget_mm


def test_the_whole_backlash_of_a_calibrated_arm_counts_where_the_approach_side_is_unknown() -> None:
    known = {sizes: budget_mm(sizes, KNOWN)["backlash"] for sizes in (ErrorSizes(), CALIBRATED)}
    assert known[CALIBRATED] == pytest.approx(0.1 * known[ErrorSizes()])
    unknown = {sizes: budget_mm(sizes, None)["backlash"] for sizes in (ErrorSizes(), CALIBRATED)}
    assert known[ErrorSizes()] < 0.9 * unknown[CALIBRATED] < unknown[ErrorSizes()]


def test_a_joint_whose_side_is_unknown_at_the_target_counts_with_its_whole_backlash() -> None:
    fifth = np.array([[1.0, 1.0, 1.0, 1.0, 0.0, 1.0]])
    spheres, target = ArmPoses(LOOKS[:-1], POINTS_MM[:-1], np.ones((4, 6))), LOOKS[-1:]
    sources = arm_sources(KR6.chain, spheres, ArmPoses(target, POINTS_MM[-1:], fifth), CALIBRATED)
    (unknown,) = (one for one in sources if one.source == "backlash" and isinstance(one, IndependentErrors))
    half_mm = 0.5 * BACKLASH_RAD * swings_mm()[:, 4]
    np.testing.assert_allclose(unknown.at_target_mm2, np.outer(half_mm, half_mm), rtol=1e-9)
    assert not unknown.at_spheres_mm2.any()


def settings(arm_error_mm: float, tool_error_mm: float) -> ProcedureSettings:
    return ProcedureSettings(arm_error_mm=arm_error_mm, tool_error_mm=tool_error_mm)


def test_without_a_record_of_the_arm_no_setting_makes_its_errors_smaller_than_uncalibrated_ones() -> None:
    typed = ErrorSizes.stated(settings(0.016, 0.1), None)
    assert typed == replace(UNCALIBRATED, tool_mm=LINK_TRANSLATION_MM)
    assert arm_error_mm(settings(0.016, 0.1), None) == UNCALIBRATED_MM
    assert ErrorSizes.stated(settings(0.15, 2.0), None) == UNCALIBRATED
    assert arm_error_mm(settings(0.15, 2.0), None) == 0.15


def test_with_a_record_of_the_arm_its_errors_are_those_of_the_record_whatever_is_set() -> None:
    dated = {"created": NOW, "expires": NOW, "identifier": "arm", "made_by": "test"}
    nothing = ArmDeviations.none(6).as_plain()
    stated = ArmCalibration(arm="kr6_r900_sixx", scatter_mm=0.02, stated_error_mm=0.03, **dated, **nothing)
    for typed in (settings(0.016, 0.1), settings(0.15, 2.0)):
        found = ErrorSizes.stated(typed, stated)
        assert found.tool_mm == pytest.approx(0.0173, abs=1e-4)
        assert found.links == found.joints == found.backlash == pytest.approx(0.245, abs=1e-3)
        worse = stated.model_copy(update={"stated_error_mm": 0.09})
        assert ErrorSizes.stated(typed, worse).links == pytest.approx(3.0 * found.links)
        more = stated.model_copy(update={"arm_error_mm": 0.016, "tool_error_mm": 0.1})
        assert ErrorSizes.stated(typed, more) == ErrorSizes(0.1, *3 * (pytest.approx(0.16),))


@pytest.mark.slow
def test_harmonics_displace_like_those_of_random_arms_with_any_phase() -> None:
    generator, flat = np.random.default_rng(1), []
    sizes_rad = np.array(HARMONIC_RAD)
    for _ in range(2000):
        amplitude = generator.normal(0.0, sizes_rad, (6, 2))
        phase = generator.uniform(0.0, 2.0 * np.pi, (6, 2))
        drawn = replace(
            ArmDeviations.none(6), sine_rad=amplitude * np.cos(phase), cosine_rad=amplitude * np.sin(phase)
        )
        flat.append(joint_errors(KR6.chain, drawn, LOOKS[-1:], 0.0)[0])
    drawn_mm2 = np.square(np.array(flat) @ swings_mm().T).sum(axis=1).mean()
    moved = displacements(KR6.chain, LOOKS[-1:], POINTS_MM[-1:], ErrorSizes())
    harmonics_mm = moved.joints_mm[0, :, :-2]  # without sag
    assert np.sum(harmonics_mm**2) == pytest.approx(drawn_mm2, rel=0.1)


def test_what_all_joints_sag_adds_up() -> None:
    sag = np.array([0.0, SAG_RAD, SAG_RAD, 0.0, 0.0, 0.0])
    bent = joint_errors(KR6.chain, replace(ArmDeviations.none(6), sag_rad=sag), LOOKS[-1:], 0.0)[0]
    at = [ArmPoses(LOOKS[rows], POINTS_MM[rows], None) for rows in (slice(4), slice(4, 5))]
    (joints,) = (one for one in arm_sources(KR6.chain, *at) if one.source == "harmonics and sag")
    assert isinstance(joints, SharedErrors)
    np.testing.assert_allclose(joints.at_target_mm[:, -1], swings_mm() @ bent, rtol=1e-9)


def swings_mm() -> NDArray[np.float64]:
    """How each joint swings the tool in the last pose, (3, 6) mm per rad."""
    return np.asarray(displacements(KR6.chain, LOOKS[-1:], POINTS_MM[-1:], ErrorSizes()).swings_mm[0])


def test_the_servo_error_does_not_count_where_it_is_measured() -> None:
    assert "servo and repeatability" in budget_mm(ErrorSizes(), KNOWN)
    measured = budget_mm(ErrorSizes(), KNOWN, servo_mm=0.0)
    assert measured["repeatability"] >= np.sqrt(3.0) * REPEATABILITY_MM
    assert measured["repeatability"] < budget_mm(ErrorSizes(), KNOWN)["servo and repeatability"]
