"""A calibration that was killed or interrupted is resumed, by the rules of a case."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from procedures.cli.calibrating.calibration import CalibrationKind, conclude, looked, report_remarks, show
from procedures.cli.calibrating.files import finished_figures
from procedures.cli.calibrating.kinds import kind_of
from procedures.cli.calibrating.running import opened_steps
from procedures.cli.case.leaving_report import leave_report, leaving_report, seal_run
from procedures.cli.case.opening import Watcher
from procedures.cli.case.request import CalibrationRun
from procedures.cli.runs.left_runs import close_again, close_left, make_ready, require_free_devices
from procedures.composition.procedure import Resumption
from procedures.engine.engine import Engine
from procedures.engine.left_run import LeftRun
from procedures.engine.order import order_of
from procedures.steps.calibration.recipe import Recipe
from ronna_hw.command_line.messages import tell
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.manifest import is_sealed


def resume_calibration(run: CalibrationRun, left: LeftRun, *, accepted: bool, as_json: bool) -> None:
    """Finish the looks, compute and leave the files; a finished one is shown.

    Raises as `resume`, and what the calibration itself raises.
    """
    recipe, folder = Recipe.read(run.recipe), left.run.path
    kind = kind_of(recipe.of)
    if left.finished:
        if not is_sealed(folder):  # it was killed between its last line and its seal
            make_ready(left)
            close_again(left)
            leave_report(folder, name_it=False)
            seal_run(folder)
        tell(f"{left.run.name} is finished: nothing remains to be done")
        show(finished_figures(folder), folder, written=run.write, as_json=as_json)
        return
    complete = _every_look_taken(recipe, left)
    if not complete:
        require_free_devices(run)
    make_ready(left)
    with leaving_report(folder, with_truth=False):
        if complete:
            _conclude(kind, run, recipe, left)
        else:
            looked(kind, recipe, run, folder, Resumption(left, accepted))
    show(finished_figures(folder), folder, written=run.write, as_json=as_json)


@contextmanager
def opened_calibration(
    run: CalibrationRun, folder: Path, watcher: Watcher, resumption: Resumption
) -> Iterator[Engine]:
    """The engine of a calibration that was left, to go home or to acknowledge what its devices hold."""
    recipe = Recipe.read(run.recipe)
    kind = kind_of(recipe.of)
    with opened_steps(
        run,
        folder,
        recipe.steps,
        watcher,
        title=kind.title,
        in_use=kind.in_use,
        recipe=recipe,
        resumption=resumption,
    ) as engine:
        yield engine


def _every_look_taken(recipe: Recipe, left: LeftRun) -> bool:
    order = order_of(recipe.steps, ())
    return not left.untouched and all(map(left.restored(order).stands, order.sequence))


def _conclude(kind: CalibrationKind[Any, Any], run: CalibrationRun, recipe: Recipe, left: LeftRun) -> None:
    """Compute from what was observed: nothing is moved for it, and no device is asked."""
    case = left.restored(order_of(recipe.steps, ()))
    report_remarks(kind, case)
    try:
        conclude(kind, run, kind.observed(case), left.run.path)
    except RonnaError as problem:
        close_left(left, None, "failed", code=problem.code, what=problem.what)
        raise
    close_left(left, None)
