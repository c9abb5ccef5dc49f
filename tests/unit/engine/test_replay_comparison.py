"""Rounding differences between processors are distinguished from real differences."""

from typing import Any

import pytest

from procedures.engine.replay.replay import ReplayVerdict, compare_records
from procedures.steps.clinical.set_up import CheckedSetUp
from ronna_hw.records import Record
from ronna_hw.roles import ASSISTANT, MASTER

RECORDED = {"count": 3, "centre_mm": [812.1865, 0.25], "covariance_mm2": [[1e-5, 0.0]], "joints_rad": [0.009]}


def verdict(**now: Any) -> tuple[ReplayVerdict, tuple[str, ...]]:
    was, again = (Record("09-fit", "fit", {}, payload) for payload in (RECORDED, {**RECORDED, **now}))
    found = compare_records("fit", was, again)
    return found.verdict, found.why


def test_differences_in_the_last_digits_count_as_rounded_and_are_named() -> None:
    said = verdict(centre_mm=[812.186505, 0.25], covariance_mm2=[[1.0005e-5, 0.0]], joints_rad=[0.00900001])
    assert said[0] is ReplayVerdict.ROUNDED
    assert said[1][0] == "centre_mm[0]: 812.1865 recorded, 812.186505 computed"
    assert verdict() == (ReplayVerdict.EQUAL, ())


@pytest.mark.parametrize(
    "other",
    [
        {"count": 4},
        {"centre_mm": [812.18652, 0.25]},
        {"centre_mm": [812.1865]},
        {"covariance_mm2": [[1.01e-5, 0.0]]},
        {"joints_rad": [0.0090002]},
        {"joints_rad": [float("nan")]},
    ],
)
def test_differences_beyond_rounding_count_as_different(other: dict[str, Any]) -> None:
    assert verdict(**other)[0] is ReplayVerdict.DIFFERENT


def test_only_real_differences_are_named_when_there_are_any() -> None:
    assert verdict(count=4, joints_rad=[0.00900001])[1] == ("count: 3 recorded, 4 computed",)


@pytest.mark.parametrize("assistant", [False, True])
def test_a_result_with_a_field_for_the_home_of_each_arm_is_compared_by_roles(assistant: bool) -> None:
    home, other = [0.1] * 6, [0.2] * 6
    older = {"flange": "F", "home_rad": home, "assistant_home_rad": other if assistant else None}
    newer = {"flange": "F", "homes_rad": {MASTER: home} | ({ASSISTANT: other} if assistant else {})}
    was, again = (Record("04-set_up", "set_up", {}, payload) for payload in (older, newer))
    assert compare_records("set_up", was, again, CheckedSetUp).verdict is ReplayVerdict.EQUAL
