"""A stepped case that ends with an instrument inside ends with an error."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from coded_errors import raises

from procedures.cli.case.stepping import _require_instrument_out
from procedures.engine.errors import CASE_LEFT_WITH_INSTRUMENT
from procedures.workcell.arm_history import ArmPlace, HeldInstrument, describe_instrument
from procedures.workcell.workcell import BOTH_ARMS, THE_ARM
from ronna_hw.errors import EXIT_RECOVERY_NEEDED

RUN = Path("/runs/a case")


HELD = HeldInstrument("T1", 180.0, ())


def left_with(inside: str | None, *, assumed: bool = False, held: HeldInstrument | None = None) -> Any:
    place = ArmPlace(instrument_may_be_inside=inside, assumed=assumed)
    phrases = THE_ARM if held is None else BOTH_ARMS
    workcell = SimpleNamespace(instrument_description=describe_instrument(place, held), phrases=phrases)
    return SimpleNamespace(setting=SimpleNamespace(workcell=workcell), case=SimpleNamespace(folder=RUN))


@pytest.mark.hazard(2)
@pytest.mark.parametrize(("assumed", "said"), [(False, "is still in T1"), (True, "may still be in T1")])
def test_the_end_of_the_commands_with_an_instrument_inside_is_an_error_that_names_the_way_home(
    *, assumed: bool, said: str
) -> None:
    with raises(CASE_LEFT_WITH_INSTRUMENT, match=rf"PRO-055: .* an instrument {said}") as left:
        _require_instrument_out(cast("Any", left_with("T1", assumed=assumed)))
    assert left.value.exit_code == EXIT_RECOVERY_NEEDED
    assert "ronna-procedure home '/runs/a case' asks for the removal" in left.value.advice


def test_the_end_of_the_commands_with_no_instrument_inside_is_no_error() -> None:
    _require_instrument_out(cast("Any", left_with(None)))


@pytest.mark.hazard(63)
def test_the_end_of_the_commands_with_an_instrument_in_the_holder_is_the_same_error() -> None:
    with raises(CASE_LEFT_WITH_INSTRUMENT, match=r"instrument for T1 is in the assistant's holder"):
        _require_instrument_out(left_with(None, held=HELD))
