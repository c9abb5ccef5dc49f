"""Study of `learning`: all strategies in the same cases, and what is stated of them."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from studies.accuracy.phantom import Markers, draw_phantom
from studies.accuracy.postures import ARM
from studies.accuracy.random_arms import RandomArms
from studies.campaign.study import Cell, Sums, Table
from studies.strategies.case_plans import LEARNING, move_s
from studies.strategies.learning import SCENARIOS, TARGETS_OF_CASE, Bench, CaseDraws
from studies.strategies.learning_tables import tables
from studies.strategies.study import DEPTHS_MM

ARMS = 12


@pytest.fixture(scope="module")
def listed() -> list[Table]:
    """Return the tables of one place and three targets with a dozen arms of each kind."""
    phantom = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS_OF_CASE)
    sums: dict[str, Sums] = {}
    for kind, scenario in SCENARIOS.items():
        found: Sums = defaultdict(float)
        Bench.of(kind, 1, phantom).run(CaseDraws.of(3, range(ARMS), scenario), found)
        sums[f"{kind}|1"] = found
    return tables(sums)


def row(table: Table, **wanted: str) -> dict[str, Cell]:
    """Return the one row with these cells."""
    rows = [dict(zip(table.columns, one, strict=True)) for one in table.rows]
    (found,) = [one for one in rows if all(one[key] == value for key, value in wanted.items())]
    return found


def number(table: Table, column: str, **wanted: str) -> float:
    value = row(table, **wanted)[column]
    assert isinstance(value, float | int)
    return value


@pytest.mark.parametrize("size", ["0.5", "1", "2"])
def test_learning_is_nearer_with_no_more_looks_than_ocs_whatever_the_size_of_the_errors(
    listed: list[Table], size: str
) -> None:
    of = {"arm": "uncalibrated", "size": size, "spheres": "all"}
    for column in ("mean mm", "looks"):
        mine, other = (number(listed[0], column, strategy=one, **of) for one in (LEARNING, "ocs"))
        assert mine <= other
    assert number(listed[1], "better at %", strategy="ocs", **of) > 50.0
    assert number(listed[0], "within 95 % limit %", strategy=LEARNING, **of) > 85.0


def test_a_case_that_is_refused_has_no_error_and_is_counted(listed: list[Table]) -> None:
    of = {"arm": "uncalibrated", "effect": "flange bumped after the localization"}
    by_gauge, by_residual = (
        number(listed[2], f"refused by {one} %", strategy="ocs", **of) for one in ("gauge", "residual")
    )
    paired = number(listed[2], "paired targets", strategy="ocs", **of)
    used = 1.0 - (by_gauge + by_residual) / 100.0
    assert by_gauge > 50.0
    assert paired == round(used * number(listed[2], "targets", strategy="ocs", **of))


def test_arms_twice_as_bad_have_twice_the_errors_but_the_same_repeatability() -> None:
    drawn = RandomArms.draw(4, [1, 2])
    larger = drawn.times(np.array([2.0, 1.0]))
    flanks = np.ones((2, 1, 6))
    joints = np.tile(np.array(ARM.home_rad), (2, 1, 1))
    right = drawn.times(np.zeros(2)).tool_points_mm(joints, flanks)
    apart, twice = (one.tool_points_mm(joints, flanks) - right for one in (drawn, larger))
    np.testing.assert_allclose(twice[0], 2.0 * apart[0], rtol=0.01, atol=0.01)
    np.testing.assert_allclose(twice[1], apart[1], atol=1e-9)
    assert larger.repeatability_mm == drawn.repeatability_mm


def test_a_move_takes_as_long_as_its_slowest_joint() -> None:
    start, far, near = np.zeros(6), np.array([1.0, 0.1, 0, 0, 0, 0]), np.array([1.0, 0, 0, 0, 0, 0])
    assert move_s(start, start) == 0.0
    assert move_s(start, far) == move_s(start, near) > move_s(start, 0.5 * near)
