"""The order of a case: derived from the steps, their scopes and the strategy."""

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell

from procedures.engine.errors import UnknownStep
from procedures.engine.order import CaseOrder, order_of
from procedures.journal.errors import StepRefused
from procedures.steps.catalogue import CLINICAL_STEPS
from ronna_hw.log_output import LOG_FILE, keep_log


def names(order: CaseOrder) -> list[str]:
    return [str(key) for key in order.sequence]


def test_steps_for_each_trajectory_run_one_trajectory_at_a_time() -> None:
    assert names(plain_order()) == [
        "image",
        *("localization:T1", "fit:T1", "localization:T2", "fit:T2"),
        "tool_on",
        *("approach:T1", "held:T1", "back:T1", "approach:T2", "held:T2", "back:T2"),
    ]


def test_a_strategy_that_localizes_once_has_a_single_localization() -> None:
    once = names(plain_order(localizes_per_trajectory=False))
    assert once[:4] == ["image", "localization", "fit", "tool_on"]
    assert once[4:] == names(plain_order())[6:]


def test_every_clinical_registration_precedes_the_tool_change() -> None:
    case = names(order_of(CLINICAL_STEPS, ("T1", "T2")))
    exchanged = case.index("tool_change")
    assert max(case.index(f"registration:{name}") for name in ("T1", "T2")) < exchanged
    assert min(case.index(f"positioning:{name}") for name in ("T1", "T2")) > exchanged


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("drilling", "image, localization:T1"),  # all there are
        ("approach", "Did you mean approach:T1 or approach:T2"),
        ("localisation:T2", "Did you mean localization:T2"),
        ("imgae", "Did you mean image"),
    ],
)
def test_an_unknown_step_is_reported_with_suggestions_or_the_existing_ones(typed: str, said: str) -> None:
    with pytest.raises(UnknownStep, match=said):
        plain_order("T1", "T2").find(typed)


def test_a_step_that_serves_all_trajectories_is_named_when_it_is_asked_for_with_one() -> None:
    order = order_of(CLINICAL_STEPS, ("T1", "T2"))
    with pytest.raises(UnknownStep, match=r"one plan_check serves all trajectories\. Name plan_check"):
        order.find("plan_check:T1")


REGISTERED = ("image", "localization:T1", "fit:T1", "localization:T2", "fit:T2", "tool_on")
BACK = (*REGISTERED, "approach:T1", "held:T1", "back:T1")
INSIDE = (*BACK, "approach:T2", "held:T2")


@pytest.mark.hazard(24)
@pytest.mark.parametrize(
    ("name", "latest", "standing", "reason"),
    [
        ("image", None, (), None),
        ("localization:T1", "image", ("image",), None),
        ("localization:T1", "fit:T2", REGISTERED, None),  # again
        ("approach:T2", "tool_on", REGISTERED, None),  # any trajectory may be the first
        ("fit:T1", "image", ("image",), "localization:T1 comes first"),
        ("tool_on", None, (), "image comes first"),
        ("back:T2", "held:T2", INSIDE, None),
        ("back:T1", "held:T2", INSIDE, "only back:T2 may follow held:T2"),
        ("approach:T1", "held:T2", INSIDE, "only back:T2 may follow held:T2"),
        ("image", "held:T2", INSIDE, "only back:T2 may follow held:T2"),
        ("back:T1", "back:T1", BACK, "it must directly follow held:T1"),
    ],
)
def test_a_step_may_run_when_its_predecessors_are_done_and_no_other_sequence_is_unfinished(
    name: str, latest: str | None, standing: tuple[str, ...], reason: str | None
) -> None:
    order = plain_order()
    before = order.find(latest) if latest else None
    unmet = order.unmet(order.find(name), before, lambda key: str(key) in standing)
    assert unmet == (() if reason is None else (reason,))


@pytest.mark.hazard(35)
def test_the_log_of_a_case_has_numbers_of_trajectories_and_no_names(cell: RecordingCell) -> None:
    with keep_log(cell.folder):
        engine = cell.engine(plain_order("DOE_JOHN", "DOE"))
        engine.run_step(engine.order.find("image"))
        engine.run_step(engine.order.find("localization:DOE_JOHN"))
        with pytest.raises(StepRefused):
            engine.run_step(engine.order.find("fit:DOE"))
    log = (cell.folder / LOG_FILE).read_text()
    assert "localization:1" in log
    assert "localization:2 comes first" in log
    assert "DOE" not in log


def test_only_whole_words_are_taken_for_the_name_of_a_trajectory() -> None:
    order = plain_order("DOE", "A+")
    assert order.without_names("DOE: A+, not DOE_JOHN or ADOE") == "1: 2, not DOE_JOHN or ADOE"


def test_a_name_that_is_the_number_of_another_trajectory_stays_apart_from_it() -> None:
    order = plain_order("B", "1")
    assert order.without_names("guide(B) guide(1)") == "guide(1) guide(2)"
