"""The reference frame on the mount is found by arm and tracker, and bad looks are refused."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation

from benchmarks.mount.tracker_frame_calibration import FrameCell, pose_difference
from procedures.calibration.errors import (
    FAR_FROM_RECORD,
    FRAME_NOT_CARRIED,
    TOO_FEW_POSES,
    TRACKER_MOVED,
    DegeneratePoses,
    DoesNotFit,
)
from procedures.calibration.frame_calibration import FrameLook, FrameLooks, Use, calibrate_frame, pairs_of
from procedures.calibration.hand_eye import PosePairs, solve
from procedures.calibration.head_model import pose_record
from ronna_hw.frames import Frame, Transform

Seen = tuple[FrameCell, FrameLooks]
COUNT, VALIDATION = 20, 8


def looks_of(seed: int, *, calibrated: bool, exact: bool = False) -> Seen:
    cell = FrameCell.of(seed, calibrated=calibrated, exact=exact)
    return cell, cell.looks(COUNT, VALIDATION)


@pytest.fixture(scope="module")
def seen() -> Seen:
    """A scene with a calibrated arm, and looks in it."""
    return looks_of(3, calibrated=True)


@pytest.fixture(scope="module")
def observed(seen: Seen) -> FrameLooks:
    return seen[1]


def among(observed: FrameLooks, looks: Sequence[FrameLook]) -> FrameLooks:
    return observed.model_copy(update={"looks": tuple(looks)})


def pushed(look: FrameLook, shift_mm: Sequence[float]) -> FrameLook:
    """The frame seen beside where it was seen, tracker frame."""
    x, y, z = np.add(look.tracker_from_marker.translation_mm, shift_mm).tolist()
    moved = look.tracker_from_marker.model_copy(update={"translation_mm": (x, y, z)})
    return look.model_copy(update={"tracker_from_marker": moved})


def exact_pairs(turns: Rotation) -> tuple[PosePairs, np.ndarray, np.ndarray]:
    """Pairs without any error, the frame on the flange and the tracker in the room."""
    generator = np.random.default_rng(1)
    frame, tracker = np.eye(4), np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.random(random_state=1).as_matrix(), (70.0, 3.0, -80.0)
    tracker[:3, :3], tracker[:3, 3] = Rotation.random(random_state=2).as_matrix(), (900.0, 1500.0, 1200.0)
    flange = np.tile(np.eye(4), (len(turns), 1, 1))
    flange[:, :3, :3], flange[:, :3, 3] = turns.as_matrix(), generator.normal(500.0, 50.0, (len(turns), 3))
    return PosePairs(flange, np.linalg.inv(tracker) @ flange @ frame), frame, tracker


def test_without_errors_frame_and_tracker_are_found_exactly() -> None:
    turns = Rotation.from_rotvec(np.random.default_rng(0).normal(0.0, 0.4, (20, 3)))
    pairs, frame, tracker = exact_pairs(turns)
    found = solve(pairs)
    assert np.allclose(found.flange_from_marker, frame, atol=1e-8)
    assert np.allclose(found.robot_from_tracker, tracker, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 4, 15])
def test_with_a_calibrated_arm_the_frame_is_where_a_perfect_tracker_would_find_it(seed: int) -> None:
    cell, observed = looks_of(seed, calibrated=True)
    _, perfect = looks_of(seed, calibrated=True, exact=True)
    result = calibrate_frame(observed)
    truth = solve(pairs_of([one for one in perfect.looks if one.use is not Use.RETURN]))
    error_mm, error_deg = pose_difference(result.fit.flange_from_marker, truth.flange_from_marker)
    assert error_mm <= 0.15
    assert error_deg <= 0.05
    drawn_mm, drawn_deg = pose_difference(result.fit.flange_from_marker, cell.true_frame)
    assert drawn_mm <= 4.0 * result.tracker_frame.stated_error_mm
    assert drawn_deg <= 0.05


def test_an_uncalibrated_arm_enters_the_stated_error(seen: Seen) -> None:
    cell, observed = looks_of(3, calibrated=False)
    result = calibrate_frame(observed)
    error_mm, _ = pose_difference(result.fit.flange_from_marker, cell.true_frame)
    assert result.fit.error_mm < 0.15 < result.tracker_frame.stated_error_mm
    assert error_mm <= 3.0 * result.tracker_frame.stated_error_mm
    calibrated = calibrate_frame(seen[1])
    assert calibrated.tracker_frame.stated_error_mm < result.tracker_frame.stated_error_mm


def test_the_record_is_dated_and_relative_to_the_head_on_the_same_mount(observed: FrameLooks) -> None:
    result = calibrate_frame(observed, life=timedelta(days=3))
    record = result.tracker_frame
    assert (record.created, record.expires) == (observed.created, observed.created + timedelta(days=3))
    assert record.tool == observed.start.tool
    head = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    again = head @ record.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    assert np.allclose(again.as_matrix(), result.fit.flange_from_marker, atol=1e-6)


def test_held_out_looks_agree_with_the_predicted_error(seen: Seen) -> None:
    result = calibrate_frame(seen[1])
    assert len(result.misses_mm) == VALIDATION
    rms_mm = float(np.sqrt(np.mean(np.sum(result.misses_mm**2, axis=1))))
    assert 0.4 * result.predicted_mm < rms_mm < 1.7 * result.predicted_mm


def test_too_few_poses_are_refused(observed: FrameLooks) -> None:
    few = [one for one in observed.looks if one.use is not Use.FIT]
    with raises(TOO_FEW_POSES, match="CAL-002"):
        calibrate_frame(among(observed, few))
    with raises(TOO_FEW_POSES, match="validate"):
        calibrate_frame(among(observed, [one for one in observed.looks if one.use is not Use.VALIDATION]))
    with raises(TOO_FEW_POSES, match="did not return"):
        calibrate_frame(among(observed, [one for one in observed.looks if one.use is not Use.RETURN]))


def test_turns_about_nearly_parallel_axes_are_refused() -> None:
    axis = np.array([0.2, 0.3, 0.9])
    turns = Rotation.from_rotvec(np.linspace(-1.0, 1.0, 20)[:, None] * axis)
    pairs, _, _ = exact_pairs(turns)
    with pytest.raises(DegeneratePoses, match="nearly parallel axes"):
        solve(pairs)


def test_a_frame_that_is_not_mounted_on_the_arm_is_refused(observed: FrameLooks) -> None:
    resting = observed.looks[0].tracker_from_marker
    looks = [one.model_copy(update={"tracker_from_marker": resting}) for one in observed.looks]
    with raises(FRAME_NOT_CARRIED, match="CAL-015"):
        calibrate_frame(among(observed, looks))


def test_a_tracker_that_moved_during_calibration_is_detected_at_the_repeated_pose(
    observed: FrameLooks,
) -> None:
    *looks, last = observed.looks
    assert last.use is Use.RETURN
    with raises(TRACKER_MOVED, match="CAL-016") as refused:
        calibrate_frame(among(observed, [*looks, pushed(last, (0.0, 0.4, 0.0))]))
    assert refused.value.got is not None
    assert refused.value.got.startswith("0.4")


def test_a_creeping_tracker_is_detected_although_no_single_step_is(observed: FrameLooks) -> None:
    first, *_ = (one for one in observed.looks if one.use is Use.RETURN)
    others = [one for one in observed.looks if one.use is not Use.RETURN]
    creeping = [pushed(first, (0.0, 0.15 * step, 0.0)) for step in range(3)]
    with raises(TRACKER_MOVED, match="between measurements 1 and 3"):
        calibrate_frame(among(observed, [*others, *creeping]))


def test_poses_that_do_not_fit_the_others_are_refused(observed: FrameLooks) -> None:
    generator = np.random.default_rng(5)

    def spoilt(use: Use, sigma_mm: float) -> FrameLooks:
        looks = [
            pushed(one, generator.normal(0.0, sigma_mm, 3)) if one.use is use else one
            for one in observed.looks
        ]
        return among(observed, looks)

    with pytest.raises(DoesNotFit, match="no pose of the frame"):
        calibrate_frame(spoilt(Use.FIT, 2.0))
    with pytest.raises(DoesNotFit, match="kept for validation"):
        calibrate_frame(spoilt(Use.VALIDATION, 1.0))


def test_a_result_far_from_the_record_is_refused_with_a_corrective_action(observed: FrameLooks) -> None:
    upside_down = Transform.of(
        Frame.TOOL, Frame.MARKER, translation_mm=(150.0, 0.0, 140.0), quaternion_wxyz=(0.0, 1.0, 0.0, 0.0)
    )
    start = observed.start.model_copy(update={"tool_from_marker": pose_record(upside_down)})
    with raises(FAR_FROM_RECORD, match="CAL-017") as refused:
        calibrate_frame(observed.model_copy(update={"start": start}))
    assert "millimetres, quaternion with the scalar first" in refused.value.action
