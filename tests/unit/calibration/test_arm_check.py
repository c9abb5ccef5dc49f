"""A check tells an arm that has changed from one with the errors that its record leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from arm_looks import ENDPOINTS, SPHERES_MM, LookingArm
from coded_errors import raises

from procedures.calibration.arm_calibration import calibrate_arm
from procedures.calibration.arm_check import check_arm
from procedures.calibration.arm_model import ArmLooks
from procedures.calibration.errors import ARM_CHANGED
from ronna_hw.config import parse_theatre
from sim.theatre.theatre_file import theatre_content
from sim.world.process import load_scene
from sim.world.true_arm import TrueArm

SEEDS = range(20)
A3, A5 = 2, 4
ELSEWHERE_MM = tuple((x + 40.0, y - 20.0, z + 20.0) for x, y, z in SPHERES_MM)


def seen_by(seed: int) -> ArmLooks:
    """Measurements in the mini scene's theatre, of an arm whose record is as good as it says."""
    scene = load_scene("mini", seed=seed, calibrated=True)
    calibrations = parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)).calibration
    assert calibrations is not None
    arm = LookingArm(scene, TrueArm(scene.arm, seed), calibrations.stereo_head)
    return arm.looks(0, 24, SPHERES_MM).model_copy(update={"arm_record": calibrations.arm})


def mastered_anew(observed: ArmLooks, joint: int, off_deg: float) -> ArmLooks:
    assert observed.arm_record is not None
    offsets = list(observed.arm_record.joint_offset_rad)
    offsets[joint] += math.radians(off_deg)
    record = observed.arm_record.model_copy(update={"joint_offset_rad": tuple(offsets)})
    return observed.model_copy(update={"arm_record": record})


def with_slipped_head(observed: ArmLooks, by_mm: float) -> ArmLooks:
    pose = observed.stereo_head.flange_from_tool
    x, y, z = pose.translation_mm
    slipped = pose.model_copy(update={"translation_mm": (x + by_mm, y, z)})
    head = observed.stereo_head.model_copy(update={"flange_from_tool": slipped})
    return observed.model_copy(update={"stereo_head": head})


def refused(changed: Sequence[ArmLooks]) -> list[bool]:
    return [not check_arm(one).passed for one in changed]


@pytest.mark.parametrize(
    "seed", [*SEEDS[:5], *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS[5:])]
)
def test_an_intact_arm_passes_and_one_that_changed_is_refused(seed: int) -> None:
    observed = seen_by(seed)
    check_arm(observed).require()
    changed = [mastered_anew(observed, joint, 0.2) for joint in (A3, A5)]
    assert all(refused([*changed, with_slipped_head(observed, 2.0)]))
    with raises(ARM_CHANGED, match="CAL-012"):
        check_arm(changed[0]).require()


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_better_the_record_the_smaller_the_change_that_is_found(seed: int) -> None:
    arm = LookingArm.of(seed)
    result = calibrate_arm(arm.looks(90, 24, SPHERES_MM))
    observed = arm.looks(0, 24, ELSEWHERE_MM).model_copy(
        update={"arm_record": result.arm, "stereo_head": result.stereo_head}
    )
    check_arm(observed).require()
    changed = [mastered_anew(observed, joint, 0.05) for joint in (A3, A5)]
    assert all(refused([*changed, with_slipped_head(observed, 0.2)]))
    of_errors_alone = result.arm.model_copy(update={"remaining": None})
    assert refused([observed.model_copy(update={"arm_record": of_errors_alone})]) == [False]


def test_the_expected_error_is_that_of_intact_arms() -> None:
    found = [check_arm(seen_by(seed)) for seed in SEEDS]
    square = sum(one.error_mm**2 for one in found) / len(found)
    expected = sum(one.expected_mm**2 for one in found) / len(found)
    # These records know harmonics, sag and backlash exactly, which they do not state.
    assert math.sqrt(square / expected) == pytest.approx(0.8, abs=0.1)
