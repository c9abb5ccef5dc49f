"""Whatever limits a theatre file sets: what the path check accepts, the driver does, as it was previewed."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Any

import pytest
from drawn_limits import LimitedDriver, drawn_options
from half_sitting import FIDUCIALS, SIGHT, TRAJECTORIES, arm_setting, reclined_ct
from strategy_arms import KR6

from drivers.kuka_rsi.options import KukaOptions
from procedures.planning.errors import NotReachable
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.motions import preview_motions
from procedures.planning.paths import check_paths
from procedures.planning.pose_name import GAUGE
from ronna_hw.arm.pose import radians6
from ronna_hw.devices import JointMove, LineMove
from ronna_hw.devices.robot import OperatingMode

pytestmark = pytest.mark.hazard(51)

HOME = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 170.0)
DRIVEN_OF_EACH = 3  # motions cycle by cycle; all others are planned and checked for clearance
AGREE = 0.02
LIMITS = {"speed_fraction", "range_margin_deg", "line_speed_mm_s"}
GENEROUS_S = 60.0


def _case_is_carried_out(seed: int) -> bool:
    """One set of limits: whether the path check accepts the procedure; the driver then does all of it."""
    rng = random.Random(seed)
    driver = LimitedDriver(KR6, drawn_options(rng), rng.choice(list(OperatingMode)))
    head_mm = (rng.uniform(450.0, 900.0), rng.uniform(-450.0, 450.0), rng.uniform(0.0, 450.0))
    setting = arm_setting(reclined_ct(middle_mm=head_mm), limits=driver.limits, start_rad=HOME)
    assert setting.scene is not None
    check = check_paths(setting, TRAJECTORIES, FIDUCIALS)
    if not check.passed:
        assert all("[ARM-" in one.reason for one in check.unmet), check.unmet
        return False
    previewed = preview_motions(setting, setting.scene, check, TRAJECTORIES)
    for one in previewed:
        driver.planned(one.motion)
    for one in rng.sample(previewed, DRIVEN_OF_EACH):
        duration_s, speed_mm_s = driver.driven(one.motion)
        where = f"{one.motion.start} to {one.motion.end}"
        assert duration_s == pytest.approx(one.preview.duration_s, rel=AGREE), where
        assert speed_mm_s == pytest.approx(one.preview.largest_speed_mm_s, rel=AGREE), where
    return True


@pytest.mark.parametrize("seed", range(8))
def test_what_the_path_check_accepts_the_driver_carries_out_as_previewed(seed: int) -> None:
    _case_is_carried_out(seed)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_two_hundred_drawn_limits_are_refused_at_the_path_check_or_carried_out_as_previewed() -> None:
    accepted = sum(_case_is_carried_out(seed) for seed in range(200))
    assert 40 <= accepted <= 190  # both happen


def test_a_margin_that_leaves_no_way_to_the_head_is_refused_with_pose_value_limit_and_action() -> None:
    limits = LimitedDriver(KR6, KukaOptions(range_margin_deg=30.0), OperatingMode.AUTOMATIC).limits
    near_the_end = (*HOME[:4], KR6.upper_rad[4] - math.radians(20.0), HOME[5])
    check = choose_free_angles(
        arm_setting(limits=limits, start_rad=near_the_end), TRAJECTORIES, FIDUCIALS, SIGHT
    ).check
    with pytest.raises(NotReachable, match="home: A5 would leave its range") as caught:
        check.require()
    assert "limit -90.0 to 90.0 deg with the margin of 30, got 100.000 deg [ARM-003]" in str(caught.value)
    assert caught.value.code == "PLAN-007"
    assert "wider range in the theatre file" in str(caught.value)


def test_a_gauge_within_the_margin_is_refused_before_anything_moves() -> None:
    limits = LimitedDriver(KR6, KukaOptions(range_margin_deg=30.0), OperatingMode.AUTOMATIC).limits
    gauge_rad = (*HOME[:4], KR6.upper_rad[4] - math.radians(20.0), HOME[5])
    setting = arm_setting(limits=limits, start_rad=HOME, gauge_rad=gauge_rad)
    check = choose_free_angles(setting, TRAJECTORIES, FIDUCIALS, SIGHT).check
    assert [one.pose for one in check.unmet] == [GAUGE]
    assert "ARM-003" in check.unmet[0].reason


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_on_the_wire_the_arm_moves_as_previewed(tapped_cell: Any, seed: int) -> None:
    drawn = drawn_options(random.Random(seed)).model_dump(include=LIMITS, exclude_none=True)
    cell, tap = tapped_cell()
    arm = cell.active_arm(silence_limit_s=GENEROUS_S, heartbeat_limit_s=GENEROUS_S, **drawn)
    start = arm.read_state().commanded_rad
    up = arm.kinematics.flange_pose(start).displace((0.0, 0.0, 60.0))
    aside = (start[0] + math.radians(25.0), *start[1:3], start[3] + math.radians(40.0), *start[4:])
    for motion in (LineMove(up), JointMove(start), JointMove(aside), JointMove(start)):
        previewed = arm.preview(motion)
        before = len(tap.acting_deg)
        arm.move(motion)
        moving = sum(a != b for a, b in pairwise(tap.acting_deg[before:]))
        assert moving * arm.limits().cycle_s == pytest.approx(previewed.duration_s, rel=AGREE)
