"""Strategies are found by name."""

from __future__ import annotations

import pytest

from procedures.strategies.catalogue import strategy_named
from procedures.strategies.errors import UnknownStrategy
from ronna_hw.errors import EXIT_USAGE


@pytest.mark.parametrize(
    ("name", "per_trajectory", "approach"),
    [
        ("ocs", True, True),
        ("thesis-ocs", True, False),
        ("nos", False, False),
        ("jdms", True, True),
        ("improved", True, True),
        ("best", True, True),
    ],
)
def test_a_strategy_declares_how_often_it_localizes_and_whether_it_controls_the_approach(
    name, per_trajectory, approach
):
    strategy = strategy_named(name)
    assert strategy.name == name
    assert strategy.localizes_per_trajectory is per_trajectory
    assert strategy.controls_approach is approach


def test_an_unknown_strategy_is_refused_and_named():
    with pytest.raises(UnknownStrategy, match=r"STR-002.*'fastest'") as caught:
        strategy_named("fastest")
    assert caught.value.exit_code == EXIT_USAGE
