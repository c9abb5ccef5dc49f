"""The tip of the guide is found relative to what the head sees, and bad readings are refused."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation
from user_commands import in_this_process

from benchmarks.mount.tool_tip_calibration import TipCell
from procedures.calibration import tip_calibration
from procedures.calibration.errors import (
    BAD_OBSERVATIONS,
    BALL_AND_DIVOT_APART,
    FAR_FROM_RECORD,
    READING_IMPLAUSIBLE,
    TOO_FEW_POSES,
    DegeneratePoses,
    DoesNotFit,
)
from procedures.calibration.tip_calibration import (
    LEAST_READINGS,
    LEAST_VALIDATION,
    DivotReading,
    TipLooks,
    TipPairs,
    calibrate_tip,
    fit_tip,
    pairs_of,
)
from procedures.cli.procedure import app
from ronna_hw.frames import Frame
from sim.world.rigid import matrix_of

COUNT, VALIDATION = LEAST_READINGS, LEAST_VALIDATION  # so every good calibration here passes with the fewest
Read = tuple[TipCell, TipLooks]
Numbers3 = tuple[float, float, float]


@pytest.fixture(scope="module")
def read() -> Read:
    """A scene with an uncalibrated arm, and readings in it."""
    cell = TipCell.of(3, calibrated=False)
    return cell, cell.readings(COUNT, VALIDATION)


@pytest.fixture(scope="module")
def observed(read: Read) -> TipLooks:
    return read[1]


def with_dials(one: DivotReading, more_mm: np.ndarray | Numbers3) -> DivotReading:
    x, y, z = np.add(one.dials_mm, more_mm).tolist()
    return one.model_copy(update={"dials_mm": (x, y, z)})


def among(observed: TipLooks, readings: list[DivotReading]) -> TipLooks:
    return observed.model_copy(update={"readings": tuple(readings)})


@pytest.mark.parametrize(("seed", "calibrated"), [(0, True), (5, False), (11, False)])
def test_the_tip_is_found_relative_to_what_the_head_sees_whatever_the_arm(
    seed: int, calibrated: bool
) -> None:
    cell = TipCell.of(seed, calibrated=calibrated)
    result = calibrate_tip(cell.readings(COUNT, VALIDATION))
    true = matrix_of(cell.scene.mount.tool_from_tip_true)[:3, 3]
    assert np.linalg.norm(result.fit.tip_mm - cell.seen_mm(true)) <= 0.05
    assert np.linalg.norm(result.fit.tip_mm - cell.seen_mm(true)) <= 4.0 * result.tool_tip.stated_error_mm


def test_the_record_is_dated_keeps_the_direction_of_the_guide_and_places_the_tip_as_fitted(
    observed: TipLooks,
) -> None:
    result = calibrate_tip(observed, life=timedelta(days=3))
    record, start = result.tool_tip, observed.start
    assert (record.created, record.expires) == (observed.created, observed.created + timedelta(days=3))
    assert record.tool_number == start.tool_number
    assert np.allclose(record.flange_from_tool.quaternion_wxyz, start.flange_from_tool.quaternion_wxyz)
    assert record.stated_direction_error_rad == start.stated_direction_error_rad > 0.0
    head = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    assert np.allclose(head.inverse().apply(record.flange_from_tool.translation_mm), result.fit.tip_mm)


def test_too_few_readings_are_refused(observed: TipLooks) -> None:
    kept = [one for one in observed.readings if one.look in observed.validation]
    used = [one for one in observed.readings if one.look not in observed.validation]
    with raises(TOO_FEW_POSES, match="too few readings of the divot"):
        calibrate_tip(among(observed, [*used[1:], *kept]))
    with raises(TOO_FEW_POSES, match="validate the tip"):
        calibrate_tip(among(observed, used))


def test_a_narrow_cone_is_refused(read: Read) -> None:
    cell, _ = read
    with pytest.raises(DegeneratePoses, match="too narrow a cone"):
        calibrate_tip(cell.readings(COUNT, VALIDATION, tilt_rad=0.05))


def test_dial_readings_that_were_mixed_up_are_refused(observed: TipLooks) -> None:
    generator = np.random.default_rng(2)
    spoilt = [with_dials(one, generator.normal(0.0, 0.2, 3)) for one in observed.readings]
    with pytest.raises(DoesNotFit, match="do not agree on one tip position"):
        calibrate_tip(among(observed, spoilt))


def test_held_out_readings_must_agree_with_the_fit(observed: TipLooks) -> None:
    spoilt = [
        with_dials(one, (0.2, 0.2, 0.0)) if one.look in observed.validation else one
        for one in observed.readings
    ]
    with pytest.raises(DoesNotFit, match="kept for validation"):
        calibrate_tip(among(observed, spoilt))


@pytest.mark.parametrize("dials", [(350.0, 20.0, -10.0), (0.0, float("nan"), 0.0)])
def test_implausible_readings_are_refused_with_the_value_read(observed: TipLooks, dials: Numbers3) -> None:
    first, *others = observed.readings
    wrong = first.model_copy(update={"dials_mm": dials})
    with raises(READING_IMPLAUSIBLE, match="CAL-018") as refused:
        calibrate_tip(among(observed, [wrong, *others]))
    assert refused.value.got == " ".join(f"{value:g}" for value in dials)


def test_each_reading_needs_its_own_look(observed: TipLooks) -> None:
    first, *others = observed.readings
    for wrong in (first.model_copy(update={"look": 99}), first.model_copy(update={"look": others[0].look})):
        with raises(BAD_OBSERVATIONS, match="CAL-005"):
            calibrate_tip(among(observed, [wrong, *others]))


def test_pivoting_distinguishes_a_displaced_divot_from_a_shifted_tip() -> None:
    generator = np.random.default_rng(4)
    turns = Rotation.from_rotvec(generator.normal(0.0, 0.35, (12, 3))).as_matrix()
    place, tip, gap = np.array([560.0, -320.0, 230.0]), np.array([0.4, -0.2, 0.1]), np.array([0.0, 0.2, 0.0])
    at_ball = np.tile(np.eye(4), (12, 1, 1))
    at_ball[:, :3, :3], at_ball[:, :3, 3] = turns, place
    at_divot = at_ball.copy()
    at_divot[:, :3, 3] = place - turns @ tip
    pairs = TipPairs(at_ball, at_divot, np.zeros((12, 3)), np.zeros((12, 3)))
    assert np.allclose(fit_tip(pairs).tip_mm, tip)
    assert np.allclose(fit_tip(pairs).gap_mm, 0.0, atol=1e-9)
    apart = TipPairs(at_ball, at_divot, np.zeros((12, 3)), np.tile(-gap, (12, 1)))
    with raises(BALL_AND_DIVOT_APART, match="CAL-019"):
        fit_tip(apart)


def test_an_accepted_gap_counts_in_the_stated_error_and_bad_readings_cannot_hide_one(
    observed: TipLooks,
) -> None:
    result = calibrate_tip(observed)
    assert result.tool_tip.stated_error_mm >= result.fit.gap_error_mm
    assert np.linalg.norm(result.fit.gap_mm) <= 3.0 * result.tool_tip.stated_error_mm
    generator = np.random.default_rng(2)
    shaky = [with_dials(one, generator.normal(0.0, 0.06, 3)) for one in observed.readings]
    with pytest.raises(DoesNotFit, match="cannot show whether"):
        calibrate_tip(among(observed, shaky))


def test_a_value_slightly_beyond_its_limit_is_shown_as_different_from_the_limit(
    observed: TipLooks, monkeypatch: pytest.MonkeyPatch
) -> None:
    scatter_mm = calibrate_tip(observed).fit.scatter_mm
    monkeypatch.setattr(tip_calibration, "LARGEST_SCATTER_MM", round(0.9999 * scatter_mm, 6))
    with pytest.raises(DoesNotFit, match="one tip position") as refused:
        calibrate_tip(observed)
    got, limit = (float((words or "").split()[0]) for words in (refused.value.got, refused.value.limit))
    assert got > limit


def test_similar_orientations_that_could_hide_a_large_gap_are_refused() -> None:
    generator = np.random.default_rng(5)
    turns = Rotation.from_rotvec(generator.normal(0.0, 0.17, (8, 3))).as_matrix()
    at_ball = np.tile(np.eye(4), (8, 1, 1))
    at_ball[:, :3, :3] = turns
    pairs = TipPairs(at_ball, at_ball, np.zeros((8, 3)), generator.normal(0.0, 0.03, (8, 3)))
    with pytest.raises(DoesNotFit, match="Tilt the guide farther"):
        fit_tip(pairs)


def test_the_command_requires_as_many_readings_as_the_fit_needs() -> None:
    for option, least in (("--readings", LEAST_READINGS), ("--validation", LEAST_VALIDATION)):
        done = in_this_process(app, "calibrate", "tool-tip", "--sim", option, str(least - 1))
        assert done.returncode == 2
        assert f"{least}<=x<=" in done.stderr


def test_head_and_tip_in_different_orientations_are_refused(observed: TipLooks) -> None:
    pairs = pairs_of(observed, observed.readings)
    turned = pairs.at_divot.copy()
    turned[:, :3, :3] = turned[:, :3, :3] @ Rotation.from_rotvec([0.0, 0.0, 0.02]).as_matrix()
    with pytest.raises(DoesNotFit, match="same orientation"):
        fit_tip(TipPairs(pairs.at_ball, turned, pairs.ball_mm, pairs.dials_mm))


def test_a_tip_far_from_its_record_is_refused(observed: TipLooks) -> None:
    place = observed.start.flange_from_tool
    x, y, z = place.translation_mm
    elsewhere = place.model_copy(update={"translation_mm": (x, y, z + 30.0)})
    start = observed.start.model_copy(update={"flange_from_tool": elsewhere})
    with raises(FAR_FROM_RECORD, match="CAL-017"):
        calibrate_tip(observed.model_copy(update={"start": start}))
