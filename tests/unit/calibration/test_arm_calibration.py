"""An arm is identified from looks of the simulator's own arm, and judged by held-out looks."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from arm_looks import ENDPOINTS, KINEMATICS, SPHERES_MM, LookingArm
from coded_errors import raises

from procedures.calibration.arm_calibration import ArmResult, calibrate_arm
from procedures.calibration.arm_check import check_arm
from procedures.calibration.arm_model import ArmLooks, ArmModel, arrays_of, choose_poses
from procedures.calibration.errors import (
    ARM_CHANGED,
    BAD_OBSERVATIONS,
    NO_ARM_RECORD,
    TOO_FEW_POSES,
    UNOBSERVABLE,
    ArmOlderThanHead,
    DegeneratePoses,
    DoesNotFit,
    OfAnotherTheatre,
)
from procedures.calibration.validity import require_consistent_arm
from procedures.runs.calibrations import ARM
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibrated_arm.deviations import ArmDeviations
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.calibration import ArmCalibration
from ronna_hw.config import Calibrations, ProcedureSettings, parse_theatre
from ronna_hw.frames import Frame
from sim.theatre.theatre_file import theatre_content

Identified = tuple[LookingArm, ArmLooks, ArmResult]
BeforeAndAfter = tuple[Calibrations, Calibrations]
LOOKS, VALIDATION = 90, 24


@pytest.fixture(scope="module")
def identified() -> Identified:
    arm = LookingArm.of(3)
    observed = arm.looks(LOOKS, VALIDATION, SPHERES_MM)
    return arm, observed, calibrate_arm(observed, life=timedelta(days=10))


@pytest.fixture(scope="module")
def result(identified: Identified) -> ArmResult:
    return identified[2]


def test_held_out_looks_are_predicted_as_well_as_stated(result: ArmResult) -> None:
    held = result.validation
    assert held.before_mm > 1.0
    assert 0.7 < held.error_mm / held.predicted_mm < 1.4
    assert held.error_mm < 0.04


def test_the_record_makes_predicted_errors_smaller_without_any_setting(result: ArmResult) -> None:
    written = ArmCalibration.model_validate(ARM.records_of(result)["arm"])
    sizes = ErrorSizes.stated(ProcedureSettings(), written)
    assert sizes.links < 0.4
    assert sizes.tool_mm < 0.05


def test_random_error_and_backlash_are_estimated_from_looks_that_arrive_from_both_sides(
    identified: Identified,
) -> None:
    arm, _, result = identified
    assert result.fit.scatter_mm == pytest.approx(arm.scene.arm.repeatability_mm, rel=0.2)
    np.testing.assert_allclose(result.arm.backlash_rad, arm.scene.arm.backlash_rad, atol=1e-4)


def test_points_near_the_spheres_are_reached_accurately_relative_to_each_other(
    identified: Identified,
) -> None:
    arm, _, result = identified
    calibrated = CalibratedArm(KINEMATICS, ArmDeviations.of(result.arm))
    head = result.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    nominal = arm.head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    generator = np.random.default_rng(7)
    missed = []
    for number in range(40):
        joints = np.array(KINEMATICS.home_rad) + generator.uniform(-0.2, 0.2, 6)
        true = arm.true_tool(joints, np.zeros(6), number).translation
        missed.append(
            [
                (calibrated.flange_pose(tuple(joints)) @ head).translation_mm - true,
                (KINEMATICS.flange_pose(tuple(joints)) @ nominal).translation_mm - true,
            ]
        )
    after, before = np.moveaxis(np.array(missed), 1, 0)
    spread = [
        float(np.sqrt(np.mean(np.sum((one - one.mean(axis=0)) ** 2, axis=1)))) for one in (after, before)
    ]
    assert spread[0] < 0.1
    assert spread[1] > 5.0 * spread[0]


def test_the_arms_record_is_dated_and_the_cameras_were_not_measured(identified: Identified) -> None:
    _, observed, result = identified
    assert result.arm.created == observed.created
    assert result.arm.expires - result.arm.created == timedelta(days=10)
    assert result.stereo_head.created == observed.stereo_head.created
    assert result.stereo_head.expires == observed.stereo_head.expires
    assert result.stereo_head.made_by == result.arm.made_by
    assert result.tool_tip is None
    assert ArmDeviations.of(result.arm).flat() == pytest.approx(result.fit.deviations.flat())


@pytest.fixture(scope="module")
def together(identified: Identified) -> BeforeAndAfter:
    """The records of a theatre before and after its arm is calibrated."""
    arm, observed, _ = identified
    drawn = parse_theatre(theatre_content(arm.scene, ENDPOINTS, "host:", {}, 1.0)).calibration
    assert drawn is not None
    dated = {"created": observed.created - timedelta(days=1)}
    head, tip = (one.model_copy(update=dated) for one in (drawn.stereo_head, drawn.tool_tip))
    before = drawn.model_copy(update={"stereo_head": head, "tool_tip": tip})
    found = calibrate_arm(observed.model_copy(update={"stereo_head": head, "tool_tip": tip}))
    after = {"arm": found.arm, "stereo_head": found.stereo_head, "tool_tip": found.tool_tip}
    return before, before.model_copy(update=after)


def later_than_the_arm(calibrations: Calibrations, name: str) -> Calibrations:
    assert calibrations.arm is not None
    created = calibrations.arm.created + timedelta(seconds=1)
    record = getattr(calibrations, name).model_copy(update={"created": created})
    return calibrations.model_copy(update={name: record})


def test_an_arm_has_to_be_calibrated_again_after_the_head(together: BeforeAndAfter) -> None:
    _, after = together
    require_consistent_arm(after)
    with pytest.raises(ArmOlderThanHead, match=r"CAL-021.*ronna-arm calibrate --config t\.toml"):
        require_consistent_arm(later_than_the_arm(after, "stereo_head"), "--config t.toml")


@pytest.mark.parametrize("name", ["stereo_head", "tool_tip"])
def test_an_arm_goes_only_with_the_head_and_tip_that_were_moved_when_it_was_calibrated(
    together: BeforeAndAfter, name: str
) -> None:
    before, after = together
    with pytest.raises(OfAnotherTheatre, match=rf"CAL-020.*\[calibration\.{name}\].*calibration\.toml"):
        require_consistent_arm(after.model_copy(update={name: getattr(before, name)}))


def test_a_tip_that_is_calibrated_after_the_arm_may_be_elsewhere(together: BeforeAndAfter) -> None:
    before, after = together
    require_consistent_arm(
        later_than_the_arm(after.model_copy(update={"tool_tip": before.tool_tip}), "tool_tip")
    )


def test_an_unchanged_arm_passes_its_check_and_a_slipped_head_does_not(identified: Identified) -> None:
    arm, _, result = identified
    later = arm.looks(0, 24, SPHERES_MM).model_copy(
        update={"arm_record": result.arm, "stereo_head": result.stereo_head}
    )
    check_arm(later).require()
    moved = result.stereo_head.flange_from_tool
    x, y, z = moved.translation_mm
    slipped = result.stereo_head.model_copy(
        update={"flange_from_tool": moved.model_copy(update={"translation_mm": (x + 0.3, y, z)})}
    )
    with raises(ARM_CHANGED, match="CAL-012"):
        check_arm(later.model_copy(update={"stereo_head": slipped})).require()


def test_a_check_without_a_record_names_the_command_that_makes_one() -> None:
    with raises(NO_ARM_RECORD, match="ronna-arm calibrate"):
        check_arm(LookingArm.of(3).looks(0, 12, SPHERES_MM))


def test_too_few_looks_or_none_at_all_are_refused(identified: Identified) -> None:
    _, observed, result = identified
    nothing = observed.model_copy(update={"looks": (), "arm_record": result.arm})
    with raises(TOO_FEW_POSES, match="at least 60"):
        calibrate_arm(LookingArm.of(3).looks(40, 24, SPHERES_MM))
    with raises(TOO_FEW_POSES, match=r"to calibrate.*at least 60.*got 0"):
        calibrate_arm(nothing)
    with raises(TOO_FEW_POSES, match=r"to check.*at least 12.*got 0"):
        check_arm(nothing)


@pytest.mark.parametrize("of_validation", [True, False])
def test_a_sphere_seen_only_in_one_of_both_sets_does_not_spoil_the_calibration(
    identified: Identified, of_validation: bool
) -> None:
    _, observed, whole = identified
    sphere = 3 if of_validation else 0
    looks = tuple(one for one in observed.looks if one.sphere != sphere or one.validation is of_validation)
    held = calibrate_arm(observed.model_copy(update={"looks": looks})).validation
    at_others = sum(one.validation and one.sphere != sphere for one in looks)
    assert len(held.misses_mm) == at_others
    assert held.before_mm == pytest.approx(whole.validation.before_mm, rel=0.5)


def test_looks_from_one_orientation_are_refused() -> None:
    observed = LookingArm.of(3).looks(60, 24, SPHERES_MM)
    same = observed.looks[0]
    alike = tuple(
        same.model_copy(update={"validation": number >= 60}) for number in range(len(observed.looks))
    )
    with pytest.raises(DegeneratePoses):
        calibrate_arm(observed.model_copy(update={"looks": alike}))


def test_a_sphere_that_moves_between_looks_is_refused() -> None:
    observed = LookingArm.of(3).looks(LOOKS, VALIDATION, SPHERES_MM)
    late = tuple(
        one
        if number < LOOKS // 2
        else one.model_copy(update={"point_mm": (one.point_mm[0] + 1.0, *one.point_mm[1:])})
        for number, one in enumerate(observed.looks)
    )
    with pytest.raises(DoesNotFit):
        calibrate_arm(observed.model_copy(update={"looks": late}))


def test_backlash_that_no_look_reveals_is_named_and_refused() -> None:
    one_side = LookingArm.of(3).looks(LOOKS, VALIDATION, SPHERES_MM, same_side=True)
    with raises(UNOBSERVABLE, match=r"CAL-011.*A2 backlash.*from one side"):
        calibrate_arm(one_side)


def test_looks_of_an_unknown_arm_are_refused(tmp_path: Path) -> None:
    ARM.write_looks(LookingArm.of(3).looks(0, 12, SPHERES_MM).model_copy(update={"arm": "kr3"}), tmp_path)
    with raises(BAD_OBSERVATIONS, match=r"CAL-005.*there is no arm named 'kr3'"):
        ARM.read_looks(tmp_path)


def test_looks_in_nearly_one_orientation_leave_others_undetermined_and_are_refused() -> None:
    """By held-out looks alone, which are in the same orientations, this arm is known to 0.01 mm."""
    observed = LookingArm.of(3).looks(300, 0, SPHERES_MM[:1])
    model = ArmModel(KINEMATICS, observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL))
    turned = model.rotations(arrays_of(observed.looks))
    apart = np.arccos((np.einsum("ij,mij->m", turned[0], turned) - 1.0) / 2.0)
    nearest = [observed.looks[row] for row in np.argsort(apart)[:15]]
    alike = tuple(
        one.model_copy(update={"validation": number >= 75}) for number, one in enumerate(6 * nearest)
    )
    with raises(UNOBSERVABLE, match=r"CAL-011.*least of all.*0\.1 mm in all orientations"):
        calibrate_arm(observed.model_copy(update={"looks": alike}))


def test_chosen_looks_carry_more_information_than_the_first_ones() -> None:
    arm = LookingArm.of(3)
    model = ArmModel(KINEMATICS, arm.head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL))
    candidates = arrays_of(arm.looks(200, 0, SPHERES_MM).looks)
    chosen = choose_poses(model, candidates, 40)
    assert len(set(chosen.tolist())) == 40

    def information(rows: object) -> float:
        mask = np.zeros(200, dtype=bool)
        mask[rows] = True
        part = candidates.only(mask)
        slopes = model.slopes(np.zeros(model.size + 12), part)[:, :, : model.size].reshape(-1, model.size)
        return float(np.linalg.slogdet(slopes.T @ slopes / 0.02**2 + np.eye(model.size))[1])

    assert information(chosen) > information(range(40)) + 5.0
