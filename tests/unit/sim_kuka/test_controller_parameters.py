"""Controller parameters, set by name."""

from __future__ import annotations

from dataclasses import fields

import pytest
from coded_errors import raises

from sim.kuka.command import kuka
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.errors import UNKNOWN_PARAMETER


def test_parameters_are_set_by_name() -> None:
    changed = ControllerParameters.parse(["timeout_counting=total", "streams_after_stop=false", "lag_s=0.02"])
    assert (changed.timeout_counting, changed.streams_after_stop, changed.lag_s) == ("total", False, 0.02)
    assert ControllerParameters.parse(["dead_time_cycles=3"]).dead_time_cycles == 3
    assert ControllerParameters.parse(["ipo_filter_s=0.02", "ipo_filter_s=0.03"]).ipo_filter_s == 0.03
    assert ControllerParameters.parse(["delay_lag_cycles=0", "reply_window=1"]).reply_window == 1.0
    assert ControllerParameters.parse(()) == ControllerParameters()


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("lag=1", "unknown parameter 'lag'"),
        ("lag_s", "lag_s cannot be ''"),
        ("lag_s=-1", "lag_s cannot be '-1'"),
        ("lag_s=nan", "lag_s cannot be 'nan'"),
        ("lag_s=0", "lag_s cannot be '0'; expected a number above 0"),
        ("delay_lag_cycles=-1", "delay_lag_cycles cannot be '-1'; expected a whole number of at least 0"),
        ("reply_window=1.5", "reply_window cannot be '1.5'; expected a number above 0, at most 1"),
        ("inverted_status=8", "at most 7"),
        ("dead_time_cycles=1.5", "dead_time_cycles cannot be '1.5'"),
        ("timeout_counting=some", "timeout_counting cannot be 'some'"),
        ("streams_after_stop=perhaps", "streams_after_stop cannot be 'perhaps'; expected true or false"),
    ],
)
def test_an_invalid_parameter_is_refused_with_the_expected_values(assignment: str, said: str) -> None:
    with raises(UNKNOWN_PARAMETER, match=said) as caught:
        ControllerParameters.parse([assignment])
    assert caught.value.code == "KRC-003"


def test_list_parameters_shows_every_best_estimate_with_its_meaning(
    capsys: pytest.CaptureFixture[str],
) -> None:
    kuka(list_parameters=True)
    said = capsys.readouterr().out.splitlines()
    assert len(said) == len(fields(ControllerParameters))
    assert "lag_s=0.015  Time constant of the drives, first order; 10 to 30 ms are published." in said
