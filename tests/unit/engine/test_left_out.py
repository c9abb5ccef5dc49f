"""A trajectory left out by a result is not continued; the others are completed."""

import pytest
from plain_steps import Back, Fit, plain_order
from recording_cell import RecordingCell

from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.engine.order import Outcome
from procedures.journal.results import StepResult


def fitted(cell: RecordingCell, *left_out: str, lasts: list[str] | None = None) -> Engine:
    """Three trajectories; fits leave out some. `lasts` collects which found none remaining after them."""

    def fit(context: StepContext) -> Outcome[StepResult]:
        return Outcome(Fit(not_for=(context.trajectory,) if context.trajectory in left_out else ()))

    def back(context: StepContext) -> Outcome[StepResult]:
        remain = set(context.remaining) - set(context.trajectories_done(Back)) - {context.trajectory}
        if lasts is not None and not remain:
            lasts.append(context.trajectory)
        return Outcome(Back())

    return cell.engine(plain_order("T1", "T2", "T3", fit=fit, back=back))


def test_no_further_step_runs_for_a_trajectory_that_was_left_out(cell: RecordingCell) -> None:
    engine = fitted(cell, "T2")
    engine.run_to()
    done = [step for _, step in cell.entries("result")]
    assert "fit:T2" in done
    assert not {"approach:T2", "held:T2", "back:T2"} & set(done)
    assert done[-1] == "back:T3"
    assert engine.machine.state == "finished"


def test_an_order_up_to_a_step_ends_where_that_step_is_left_out(cell: RecordingCell) -> None:
    engine = fitted(cell, "T2")
    engine.run_to(engine.order.find("approach:T2"))
    assert [step for _, step in cell.entries("result")][-1] == "fit:T2"
    assert engine.upcoming == engine.order.find("localization:T3")


def test_leaving_out_a_trajectory_is_reported_as_a_finding(cell: RecordingCell) -> None:
    engine = fitted(cell, "T2")
    reader = engine.events.subscribe()
    engine.run_to(engine.order.find("tool_on"))
    findings = [one.what for one in reader.read(0.0).events if isinstance(one.what, Advisory)]
    assert [one.text for one in findings] == ["T2 was left out: the error is too large"]
    assert cell.entries("finding") == [("finding", "")]


@pytest.mark.parametrize(("left_out", "last"), [("T3", "T2"), ("T1", "T3")])
def test_the_last_remaining_trajectory_is_the_last_of_the_case(
    cell: RecordingCell, left_out: str, last: str
) -> None:
    lasts: list[str] = []
    fitted(cell, left_out, lasts=lasts).run_to()
    assert lasts == [last]


def test_repeating_the_step_that_left_a_trajectory_out_can_include_it_again(cell: RecordingCell) -> None:
    engine = fitted(cell, "T1")
    engine.run_to(engine.order.find("fit:T3"))
    again = fitted(cell)
    again.run_step(again.order.find("fit:T1"))
    assert again.course.status(again.order.find("approach:T1")) == ""
    assert again.case.left_out == ()
