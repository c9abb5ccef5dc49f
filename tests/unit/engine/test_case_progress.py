"""A case knows its next step, its valid results, and the trajectories that are left out."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from plain_steps import Back, Fit, Held, Image, plain_order
from recording_cell import RecordingCell

from procedures.engine.case import Case
from procedures.engine.case_progress import CaseProgress
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.engine.order import Outcome, Phase
from procedures.journal.results import StepResult

REGISTERED = ("image", "localization:T1", "fit:T1", "localization:T2", "fit:T2", "tool_on")
AT_T1 = ("approach:T1", "held:T1", "back:T1")
AT_T2 = ("approach:T2", "held:T2", "back:T2")


@pytest.fixture
def course(tmp_path: Path) -> CaseProgress:
    """Of a case whose image is preoperative, and whose targets are finished once they were held."""
    changed = {Image: {"phase": Phase.PREOPERATIVE}, Held: {"finishes": True}}
    order = plain_order()
    steps = tuple(replace(step, **changed.get(step.result, {})) for step in order.steps)
    return CaseProgress(replace(order, steps=steps), Case(tmp_path))


def do(course: CaseProgress, *names: str, **results: StepResult) -> None:
    """Steps one after the other; `results` takes the place of what a step leaves, by its name."""
    for name in names:
        key = course.order.find(name)
        spec = course.order.spec(key)
        parents = [course.case.get(model, key.trajectory).record for model in spec.reads]
        result = results.get(key.name, spec.result())
        course.accept(key, course.case.store(key, result, parents))
        course.latest = key


@pytest.mark.parametrize(
    ("done", "following"),
    [
        ((), "image"),
        (("image",), "localization:T1"),
        (REGISTERED, "approach:T1"),
        ((*REGISTERED, "approach:T2"), "held:T2"),  # any may be the first: then its own steps come
        ((*REGISTERED, *AT_T2[:2]), "back:T2"),
        ((*REGISTERED, *AT_T2), "approach:T1"),
        ((*REGISTERED, *AT_T1, *AT_T2), None),
        ((*REGISTERED, "localization:T1"), "fit:T1"),  # again: what was made from it is made again
    ],
)
def test_the_mandatory_successor_comes_next_or_else_the_first_step_not_done(
    course: CaseProgress, done: tuple[str, ...], following: str | None
) -> None:
    do(course, *done)
    assert course.upcoming == (following and course.order.find(following))
    assert course.over is (following is None)


@pytest.mark.parametrize("left_before", ["held:T1", "back:T1"])
def test_an_interrupted_sequence_at_a_target_restarts_with_its_approach(
    course: CaseProgress, left_before: str
) -> None:
    do(course, *REGISTERED, *AT_T1[: AT_T1.index(left_before)])
    course.latest = None
    assert str(course.upcoming) == "approach:T1"


def test_no_step_follows_for_a_trajectory_that_was_left_out(course: CaseProgress) -> None:
    do(course, "image", "localization:T1")
    do(course, "fit:T1", fit=Fit(not_for=("T1",)))
    do(course, *REGISTERED[3:])
    approach = course.order.find("approach:T1")
    assert str(course.upcoming) == "approach:T2"
    assert course.status(approach) == "left out"
    assert course.why_not_now(approach) == ("T1 was left out: the error is too large",)


def test_a_superseded_step_that_is_not_next_is_shown_as_superseded(course: CaseProgress) -> None:
    do(course, *REGISTERED[:5], "image")
    states = [course.status(key) for key in course.order.sequence[:6]]
    assert states == ["done", "next", "superseded", "superseded", "superseded", ""]


SUPERSEDING: dict[str, Callable[[CaseProgress, str], object]] = {
    "void": lambda course, name: course.void(course.order.find(name)),
    "repeat": do,
}


@pytest.mark.parametrize(
    ("what", "step", "standing"),
    [
        ("void", "tool_on", {"T1"}),
        ("repeat", "tool_on", {"T1"}),
        ("void", "localization:T1", {"T1", "T2"}),
        ("repeat", "localization:T1", {"T2"}),  # of its own trajectory what is done again is not kept
        ("void", "image", set()),  # another CT undoes also what was finished
    ],
)
def test_a_later_move_does_not_undo_finished_targets(
    course: CaseProgress, what: str, step: str, standing: set[str]
) -> None:
    do(course, *REGISTERED, *AT_T1, "approach:T2")
    assert course.finished == ("T1",)
    SUPERSEDING[what](course, step)
    approaches = [course.order.find(name) for name in ("approach:T1", "approach:T2")]
    assert {key.trajectory for key in approaches if course.case.stands(key)} == standing


def test_no_step_follows_a_move_when_every_target_is_finished(course: CaseProgress) -> None:
    do(course, *REGISTERED, *AT_T1, *AT_T2)
    tool_on = course.order.find("tool_on")
    course.void(tool_on)
    assert course.over
    assert course.upcoming is None
    assert course.why_not_now(tool_on) == ("the work at every target is done: use home to end the case",)


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
