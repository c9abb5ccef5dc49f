"""Runs the steps of a calibration, in a folder of their own, and concludes from what they observed."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from procedures.cli.case.answers import read_answers
from procedures.cli.case.event_follower import EventFollower
from procedures.cli.case.opening import Procedure, Watcher, opened_engine
from procedures.cli.case.request import TheatreRequest, forget_if_empty, forget_if_refused
from procedures.engine.events import Event, Progress

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.engine.order import Steps
    from procedures.steps.calibration.recipe import Recipe
    from ronna_hw.config import Calibrations
    from ronna_hw.theatre import Theatre

Observed = TypeVar("Observed")  # what was observed
Result = TypeVar("Result")  # what is concluded from it
GRACE = timedelta(hours=1)  # how long a record that only serves as a start is taken for valid


def new_folder(out: Path, what: str) -> Path:
    """Make `OUT/<what>-<id>`; the id is the moment and four random hex digits."""
    folder = out / f"{what}-{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(2)}"
    folder.mkdir(parents=True)
    return folder


def run_steps(
    request: TheatreRequest,
    folder: Path,
    steps: Steps,
    progress: Callable[[float], None],
    *,
    title: str,
    answers: Path | None = None,
    in_use: Callable[[Calibrations], Calibrations] = lambda of_theatre: of_theatre,
    recipe: Recipe | None = None,
    judge: Callable[[Engine], None] = lambda _engine: None,
) -> Engine:
    """Run a calibration's steps to their end, and close everything; the engine holds the results.

    `judge` is called when every step is done; what it raises is how the run has ended.

    `title` names it in its report; `in_use` says which records to work with, given those of the theatre;
    `recipe` is what a replay makes the steps from; without one there is none.
    `answers` is a file of answers, of which PRO-026 says what does not fit.
    """

    def procedure(theatre: Theatre) -> Procedure:
        from procedures.engine.order import order_of

        return Procedure(order_of(steps, ()), title, calibrations=in_use(theatre.calibrations), recipe=recipe)

    def advance(events: Sequence[Event]) -> None:
        for event in events:
            if isinstance(event.what, Progress):
                progress(event.what.share)

    watcher = Watcher(opened=lambda engine: EventFollower(engine.events, advance).start())
    try:
        scripted = None if answers is None else read_answers(answers)
        with opened_engine(request, folder, procedure, watcher, answers=scripted) as engine:
            engine.run_to()
            judge(engine)
    except BaseException as problem:  # also an interruption: a folder that holds nothing is no run
        forget_if_refused(folder, problem)
        forget_if_empty(folder)
        raise
    return engine


def concluded(
    folder: Path,
    recorded: Observed | None,
    look: Callable[[Callable[[Observed], None]], None],
    conclude: Callable[[Observed], Result],
) -> Result:
    """What `conclude` makes of recorded observations, or else of those that `look` hands on.

    `look` calls back within its run: what `conclude` raises is how that run has ended.
    """
    from procedures.cli.case.leaving_report import leaving_report

    if recorded is not None:
        return conclude(recorded)
    results: list[Result] = []
    with leaving_report(folder, with_truth=False):
        look(lambda observed: results.append(conclude(observed)))
    (result,) = results
    return result


def valid_now(calibrations: Calibrations, *names: str) -> Calibrations:
    """The same records; those named, or else all, only serve as a start, and their age does not matter."""
    later = datetime.now(UTC) + GRACE
    return calibrations.model_copy(
        update={
            name: record.model_copy(update={"expires": later})
            for name, record in calibrations.records.items()
            if not names or name in names
        }
    )
