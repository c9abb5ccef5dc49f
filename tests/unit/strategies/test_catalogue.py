"""Strategies are found by name; later ones say so."""

from __future__ import annotations

import pytest

from procedures.strategies.catalogue import strategy_named
from procedures.strategies.errors import StrategyNotYet, UnknownStrategy
from ronna_hw.errors import EXIT_USAGE


def test_ocs_localizes_for_every_trajectory():
    ocs = strategy_named("ocs")
    assert ocs.name == "ocs"
    assert ocs.localizes_per_trajectory


@pytest.mark.parametrize("name", ["nos", "jdms", "best"])
def test_later_strategies_answer_not_yet(name):
    with pytest.raises(StrategyNotYet, match=r"STR-001.*not yet") as caught:
        strategy_named(name)
    assert caught.value.exit_code == EXIT_USAGE


def test_an_unknown_strategy_is_named():
    with pytest.raises(UnknownStrategy, match=r"STR-002.*'fastest'") as caught:
        strategy_named("fastest")
    assert caught.value.exit_code == EXIT_USAGE
