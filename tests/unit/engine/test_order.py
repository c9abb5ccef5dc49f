"""The order of a case: derived from the steps, their scopes and the strategy."""

import pytest
from plain_steps import plain_order

from procedures.engine.errors import UnknownStep
from procedures.engine.order import CaseOrder, order_of
from procedures.engine.step import StepKey
from procedures.steps.catalogue import CLINICAL_STEPS


def names(order: CaseOrder) -> list[str]:
    return [str(key) for key in order.sequence]


def test_what_is_done_for_each_trajectory_is_done_one_trajectory_at_a_time() -> None:
    assert names(plain_order()) == [
        "image",
        *("localization:T1", "fit:T1", "localization:T2", "fit:T2"),
        "tool_on",
        *("approach:T1", "held:T1", "back:T1", "approach:T2", "held:T2", "back:T2"),
    ]


def test_a_strategy_that_localizes_once_has_one_localization() -> None:
    once = names(plain_order(localizes_per_trajectory=False))
    assert once[:4] == ["image", "localization", "fit", "tool_on"]
    assert once[4:] == names(plain_order())[6:]


def test_of_the_clinical_case_every_registration_comes_before_the_tool_change() -> None:
    case = names(order_of(CLINICAL_STEPS, ("T1", "T2")))
    exchanged = case.index("tool_change")
    assert max(case.index(f"registration:{name}") for name in ("T1", "T2")) < exchanged
    assert min(case.index(f"positioning:{name}") for name in ("T1", "T2")) > exchanged


def test_an_unknown_step_names_those_that_exist() -> None:
    with pytest.raises(UnknownStep, match="image, localization:T1"):
        plain_order().find("drilling")


def unmet(name: str, latest: str | None, *standing: str) -> tuple[str, ...]:
    order = plain_order()
    before: StepKey | None = order.find(latest) if latest else None
    return order.unmet(order.find(name), before, lambda key: str(key) in standing)


REGISTERED = ("image", "localization:T1", "fit:T1", "localization:T2", "fit:T2", "tool_on")


def test_the_next_step_may_come() -> None:
    assert unmet("image", None) == ()
    assert unmet("localization:T1", "image", "image") == ()


def test_a_step_may_not_be_skipped() -> None:
    assert unmet("fit:T1", "image", "image") == ("it may not follow image: localization:T1 is not done",)
    assert unmet("image", None) == ()
    assert unmet("tool_on", None) == ("image is not done",)


def test_a_step_that_is_done_may_be_repeated() -> None:
    assert unmet("localization:T1", "fit:T2", *REGISTERED) == ()


def test_any_trajectory_may_be_the_first() -> None:
    assert unmet("approach:T2", "tool_on", *REGISTERED) == ()


@pytest.mark.hazard(24)
def test_with_the_instrument_inside_only_the_same_trajectory_goes_on() -> None:
    inside = (*REGISTERED, "approach:T1", "held:T1", "back:T1", "approach:T2", "held:T2")
    assert unmet("back:T2", "held:T2", *inside) == ()
    assert unmet("back:T1", "held:T2", *inside) == ("it may not follow held:T2: only back:T2 may",)
    assert unmet("approach:T1", "held:T2", *inside) == ("it may not follow held:T2: only back:T2 may",)
    assert unmet("image", "held:T2", *inside) == ("it may not follow held:T2: only back:T2 may",)


def test_a_step_that_continues_another_comes_right_after_it() -> None:
    done = (*REGISTERED, "approach:T1", "held:T1", "back:T1")
    assert unmet("back:T1", "back:T1", *done) == ("it must follow held:T1",)
