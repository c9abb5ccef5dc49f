"""Worth of `learning` with what a whole case has and its study lacks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from procedures.strategies.names import DEFAULT_STRATEGY
from studies.accuracy.phantom import Markers, draw_phantom
from studies.strategies.case_plans import LEARNING, CasePlanner, PlannedLooks
from studies.strategies.learning import TARGETS_OF_CASE, plan_case
from studies.strategies.learning_in_case import (
    CALIBRATED,
    GUIDE,
    HEAD,
    RECORD,
    SCAN,
    STRETCHED,
    list_settings,
    plan_looks,
    square_errors_mm2,
)
from studies.strategies.study import DEPTHS_MM


@cache
def planned() -> tuple[CasePlanner, dict[str, PlannedLooks]]:
    """Plan one case of calibrated arms by the sizes of the study."""
    planner = plan_case(CALIBRATED, draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS_OF_CASE), 1)
    return planner, plan_looks(planner)


def square_mm2(strategy: str, name: str, *, allows_scan: bool | None = None) -> float:
    planner, looks = planned()
    setting = list_settings(CALIBRATED, planner.sizes)[name]
    if allows_scan is not None:
        setting = replace(setting, allows_scan=allows_scan)
    return sum(square_errors_mm2(planner, looks[strategy], setting, learns=strategy == LEARNING))


def test_an_arm_whose_joints_are_known_leaves_less_to_learn() -> None:
    gains = [square_mm2(DEFAULT_STRATEGY, one) - square_mm2(LEARNING, one) for one in (HEAD, RECORD)]
    assert gains[0] > 2.0 * max(gains[1], 0.0)


def test_allowing_for_a_stretched_scan_costs_where_there_is_none_and_pays_where_there_is() -> None:
    assert square_mm2(LEARNING, SCAN) > square_mm2(LEARNING, RECORD)
    assert square_mm2(LEARNING, STRETCHED) < square_mm2(LEARNING, STRETCHED, allows_scan=False)


def test_guide_and_instrument_add_alike_to_every_strategy() -> None:
    added = [square_mm2(one, GUIDE) - square_mm2(one, SCAN) for one in (DEFAULT_STRATEGY, LEARNING)]
    assert added[0] == pytest.approx(added[1])
    assert added[0] > 0.0
