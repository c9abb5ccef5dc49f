"""`ronna-procedure replay`: what a run was begun with, found again, and each record held against a replay."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

from pydantic import ValidationError

from procedures.engine.context import ClinicalInput
from procedures.engine.errors import NotRecorded, ReplayDiffers
from procedures.engine.order import order_of
from procedures.engine.replay.comparison import ReplayedRecord, Verdict
from procedures.engine.replay.recorded_answers import CalibrationOpening, RecordedAnswers, read_answers
from procedures.engine.replay.replay import ReplayInput, replay
from procedures.engine.run_folder import RunFolder, run_of, typed
from procedures.planning.plan_file import read_plan
from procedures.steps.calibration.recipe import Recipe
from procedures.steps.catalogue import clinical_steps
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.strategies.catalogue import strategy_named
from ronna_hw.command_line.terminal import print_json, print_table, progress_bar
from ronna_hw.config import Calibrations, read_theatre_file
from ronna_hw.evidence.inspection import inspected
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.recording.reading_tape import READINGS_FILE

CONFIRMED = (Verdict.EQUAL, Verdict.ROUNDED)


def replay_run(run_folder: Path, *, as_json: bool) -> None:
    """Replay a run and print a verdict for each record. Raises PRO-024, and PRO-025 unless all are equal or
    rounded.
    """
    # Of readings that were edited a replay tells more: which results they change.
    run = run_of(inspected(run_folder, every_file=False).require_unchanged())
    answers = read_answers(run_folder)
    given = _as_set_up(run, _given(run_folder, answers))
    with progress_bar(f"recomputing {len(run.records)} results") as show:
        results = replay(run, given, answers, lambda done, of: show(done / of))
    counts = Counter(result.verdict for result in results)
    if as_json:
        totals = {str(verdict).replace(" ", "_"): counts[verdict] for verdict in Verdict}
        print_json({"run": run_folder.name, **totals, "records": [asdict(result) for result in results]})
    else:
        print_table("Recomputed results", ("record", "verdict", "why"), [_row(one) for one in results])
    unlike = [one.record for one in results if one.verdict not in CONFIRMED]
    if unlike:
        raise ReplayDiffers(f"{len(unlike)} of {len(results)} records are not confirmed: {', '.join(unlike)}")


def _given(run_folder: Path, answers: RecordedAnswers) -> ReplayInput:
    opening = answers.opening

    def placed(path: str | None) -> Path:
        if path is None:
            raise NotRecorded(f"the first line of {READINGS_FILE} does not say what the run was begun with")
        return run_folder / path  # an absolute path stays what it is

    if opening.series is None:
        return _given_calibration(opening.calibration, placed(opening.theatre_file))
    plan = placed(opening.plan)
    strategy = strategy_named(opening.strategy or "")
    order = order_of(
        clinical_steps(measure_targets=opening.measure_targets),
        [trajectory.id for trajectory in read_plan(plan).trajectories],
        localizes_per_trajectory=strategy.localizes_per_trajectory,
    )
    clinical = ClinicalInput(placed(opening.series), plan, strategy, opening.measure_targets)
    return ReplayInput(order, clinical, read_theatre_file(placed(opening.theatre_file)))


def _as_set_up(run: RunFolder, given: ReplayInput) -> ReplayInput:
    """With what the set-up recorded in place of what the theatre file says today."""
    recorded = next((record for record in run.records if record.kind == CheckedSetUp.kind), None)
    if recorded is None:
        return given
    then = typed(recorded, CheckedSetUp)
    tables = {"calibration": then.calibrations, "tools": then.tools, "flange": then.flange}
    tables |= {"cell": then.cell, "procedure": then.settings}
    return replace(given, theatre=given.theatre.model_copy(update=tables))


def _given_calibration(calibration: CalibrationOpening | None, theatre_file: Path) -> ReplayInput:
    if calibration is None:
        raise NotRecorded(
            "the run is a check or a single measurement of a calibration, which cannot be replayed"
        )
    recipe = Recipe.read(calibration.recipe)
    try:
        records = Calibrations.model_validate_json(json.dumps(calibration.records))
    except ValidationError as error:
        raise NotRecorded(f"the calibration records: {'; '.join(describe_mistakes(error))}") from error
    theatre = read_theatre_file(theatre_file)
    return ReplayInput(order_of(recipe.steps, ()), None, theatre, records, recipe.starts)


def _row(one: ReplayedRecord) -> tuple[str, str, str]:
    return one.record, one.verdict, "; ".join(one.why)
