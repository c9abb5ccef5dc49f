"""Runs the steps of a calibration, in a folder of their own, and concludes from what they observed."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.asking import WritePrompt, write_prompt
from procedures.cli.case.event_follower import EventFollower
from procedures.cli.case.opening import Watcher, opened_engine
from procedures.cli.case.request import CalibrationRun, TheatreRequest
from procedures.cli.case.request_file import write_request
from procedures.composition.procedure import Procedure, Resumption
from procedures.engine.events import Event, Progress
from ronna_hw.command_line.options import require_folder

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.engine.order import Steps
    from procedures.steps.calibration.recipe import Recipe
    from ronna_hw.command_line.messages import ProgressBar
    from ronna_hw.config import Calibrations
    from ronna_hw.theatre import Theatre


def new_folder(out: Path, what: str, request: CalibrationRun | None = None) -> Path:
    """Make `OUT/<what>-<id>`; the id is the moment and four random hex digits.

    With a request it can be resumed.
    """
    require_folder(out)
    folder = out / f"{what}-{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(2)}"
    if request is None:
        folder.mkdir(parents=True)
        return folder
    made = folder.with_name(f".{folder.name}")  # never seen without its request
    made.mkdir(parents=True)
    write_request(request, made)
    return made.rename(folder)


def run_steps(
    request: TheatreRequest,
    folder: Path,
    steps: Steps,
    bar: ProgressBar,
    *,
    title: str,
    in_use: Callable[[Calibrations], Calibrations] = lambda of_theatre: of_theatre,
    recipe: Recipe | None = None,
    judge: Callable[[Engine], None] = lambda _engine: None,
    resumption: Resumption | None = None,
) -> Engine:
    """Run a calibration's steps to their end, and close everything; the engine holds the results.

    `bar` shows their progress and pauses while a question is asked. `judge` is called when every step is
    done; what it raises is how the run has ended. With `resumption`, steps with valid results are not
    repeated, and nothing moves until the findings are accepted.
    """

    def advance(events: Sequence[Event]) -> None:
        for event in events:
            if isinstance(event.what, Progress):
                bar(event.what.share)

    @contextmanager
    def asking() -> Iterator[WritePrompt]:
        with bar.hidden():  # it would write over the question
            yield write_prompt

    watcher = Watcher(opened=lambda engine: EventFollower(engine.events, advance).start(), asking=asking)
    with opened_steps(
        request,
        folder,
        steps,
        watcher,
        title=title,
        in_use=in_use,
        recipe=recipe,
        resumption=resumption,
    ) as engine:
        if resumption is not None and not resumption.left.untouched:
            from procedures.recovery import recover

            recover(engine, resumption.left)
        engine.run_to()
        judge(engine)
    return engine


@contextmanager
def opened_steps(
    request: TheatreRequest,
    folder: Path,
    steps: Steps,
    watcher: Watcher,
    *,
    title: str,
    in_use: Callable[[Calibrations], Calibrations],
    recipe: Recipe | None,
    resumption: Resumption | None = None,
) -> Iterator[Engine]:
    """The engine of a calibration's steps, ready to run the first that does not stand.

    `title` names it in its report; `in_use` says which records to work with, given those of the theatre;
    `recipe` is what a replay makes the steps from; without one there is none.
    """

    def procedure(theatre: Theatre) -> Procedure:
        from procedures.engine.order import order_of

        return Procedure(order_of(steps, ()), title, calibrations=in_use(theatre.calibrations), recipe=recipe)

    with opened_engine(
        request, folder, procedure, watcher, answers=request.answers, resumption=resumption
    ) as engine:
        yield engine
