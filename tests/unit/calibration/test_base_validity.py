"""A calibration of the bases falls with a platform that moved, and with another arm."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.base_validity import (
    ArmIdentity,
    platform_shift,
    require_these_arms,
    require_unmoved,
)
from procedures.calibration.errors import BasesOfOtherArms, DegeneratePoses, PlatformMoved
from ronna_hw.calibration import BaseCalibration, FrameReference, PoseRecord

Array = NDArray[np.float64]

MASTER_MM = np.array([(0.0, 0.0, -1800.0), (250.0, 30.0, -1900.0), (40.0, 260.0, -1850.0)])
ASSISTANT_MM = MASTER_MM + np.array((150.0, -200.0, 50.0))
KR6 = ArmIdentity("kr6_r900_sixx", "123")
UR5 = ArmIdentity("ur5e", "20195500001")


def references(places_mm: Array) -> tuple[FrameReference, ...]:
    return tuple(
        FrameReference(joints_rad=(0.0,) * 6, tracker_from_frame_mm=(x, y, z))
        for x, y, z in places_mm.tolist()
    )


def record() -> BaseCalibration:
    made = datetime(2026, 1, 1, tzinfo=UTC)
    return BaseCalibration(
        identifier="bases-1",
        created=made,
        expires=made + timedelta(days=30),
        made_by="a test",
        stated_error_mm=0.08,
        master=KR6.arm,
        master_serial=KR6.serial,
        assistant=UR5.arm,
        robot_from_base=PoseRecord(translation_mm=(600.0, -800.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)),
        region_mm=(640.0, -260.0, 430.0),
        refined=True,
        frame="assistant_frame",
        master_references=references(MASTER_MM),
        assistant_references=references(ASSISTANT_MM),
    )


def seen(places_mm: Array) -> Array:
    """The places as a tracker sees them that was moved meanwhile."""
    return np.asarray(Rotation.from_rotvec((0.02, -0.05, 0.03)).apply(places_mm)) + np.array(
        (12.0, -30.0, 8.0)
    )


def test_a_moved_tracker_is_no_moved_platform() -> None:
    assert require_unmoved(record(), seen(MASTER_MM), seen(ASSISTANT_MM)).shift_mm < 1e-6


@pytest.mark.parametrize("by_mm", [(0.21, 0.0, 0.0), (0.0, -0.13, 0.17)])
def test_a_platform_that_moved_by_a_fifth_of_a_millimetre_voids_the_calibration(
    by_mm: tuple[float, float, float],
) -> None:
    with pytest.raises(PlatformMoved, match="CAL-023"):
        require_unmoved(record(), seen(MASTER_MM), seen(ASSISTANT_MM + by_mm))


def test_the_stated_error_of_a_shift_is_the_one_found() -> None:
    draws, shifts, sigma_mm = np.random.default_rng(4), [], 0.02
    for _ in range(400):
        noisy = [places + draws.normal(0.0, sigma_mm, places.shape) for places in (MASTER_MM,) * 2]
        other = [places + draws.normal(0.0, sigma_mm, places.shape) for places in (ASSISTANT_MM[:1],) * 2]
        found = platform_shift(noisy[0], noisy[1], other[0], other[1], sigma_mm)
        shifts.append(found.shift_mm)
    assert np.sqrt(np.mean(np.square(shifts))) == pytest.approx(found.error_mm, rel=0.1)


def test_references_on_one_line_show_nothing() -> None:
    line_mm = MASTER_MM[0] + np.outer((0.0, 1.0, 2.0), (100.0, 0.0, 0.0))
    with pytest.raises(DegeneratePoses):
        platform_shift(line_mm, line_mm, ASSISTANT_MM, ASSISTANT_MM)


def test_a_calibration_holds_for_its_arms_as_far_as_they_report_numbers() -> None:
    require_these_arms(record(), KR6, UR5)  # the record has no number of the assistant
    require_these_arms(record(), ArmIdentity(KR6.arm), UR5)


@pytest.mark.parametrize(
    ("master", "assistant"),
    [(ArmIdentity(KR6.arm, "124"), UR5), (UR5, KR6), (KR6, ArmIdentity("ur5"))],
)
def test_a_calibration_of_other_arms_is_refused(master: ArmIdentity, assistant: ArmIdentity) -> None:
    with pytest.raises(BasesOfOtherArms, match="CAL-024"):
        require_these_arms(record(), master, assistant)
