"""Which arm errors count, given what is known of its joints and its looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from procedures.calibration.arm_geometry import HARMONIC_RAD
from procedures.calibration.arm_sources import (
    REPEATABILITY_MM,
    ArmPoses,
    ErrorSizes,
    arm_sources,
    displacements,
)
from procedures.registration.target_prediction import predict_target_error
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.deviations import ArmDeviations, joint_errors
from ronna_hw.arm.kr6_r900 import ArmVariant, kr6_r900

KR6 = kr6_r900(ArmVariant.SIXX)
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


def swings_mm() -> NDArray[np.float64]:
    """How each joint swings the tool in the last pose, (3, 6) mm per rad."""
    return np.asarray(displacements(KR6.chain, LOOKS[-1:], POINTS_MM[-1:], ErrorSizes()).swings_mm[0])


def test_the_servo_error_does_not_count_where_it_is_measured() -> None:
    assert "servo and repeatability" in budget_mm(ErrorSizes(), KNOWN)
    measured = budget_mm(ErrorSizes(), KNOWN, servo_mm=0.0)
    assert measured["repeatability"] >= np.sqrt(3.0) * REPEATABILITY_MM
    assert measured["repeatability"] < budget_mm(ErrorSizes(), KNOWN)["servo and repeatability"]
