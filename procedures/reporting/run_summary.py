"""Summary of a run for `list` and `show`. As JSON, these models are what their `--json` prints."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import cast

from pydantic import Field, JsonValue

from procedures.journal.journal import ONLY_LEAVING, Entry
from procedures.journal.results import FramedPose, Values
from procedures.operator.margin import MarginVerdict
from procedures.reporting.ending import (
    STOPPED,
    UNSEALED,
    advise,
    advise_on_changed,
    ending_of,
    is_resumable,
    name_next_command,
    resumes,
)
from procedures.reporting.outcome import Truth
from procedures.reporting.run_reading import RunReading, describe_strategies
from procedures.reporting.tables import TargetRow, target_rows
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import AssistedInsertion, KnownBases
from procedures.steps.clinical.work_progress import STAGES
from procedures.workcell.arm_history import ArmHistory, describe_instrument, fold_arms
from ronna_hw.evidence.journal_reading import JournalCorrupt
from ronna_hw.roles import MASTER
from ronna_hw.text import escape_controls


class BasesFigures(Values):
    """How well the bases of two arms are known relative to each other; see `KnownBases`."""

    meeting_mm: float
    robot_from_base: FramedPose
    by_frames_mm: float
    error_mm: float
    apart_mm: float
    scatter_mm: float
    frame_looks: tuple[int, int]
    ball_looks: int
    outliers: int


class TwoArms(Values):
    """Figures of a case with two arms."""

    bases: BasesFigures | None = Field(description="None unless they are known.")
    insertions: dict[str, AssistedInsertion] = Field(description="By the assistant, by trajectory.")


class SummarizedTarget(Values):
    """Prediction and error at a target."""

    id: str
    strategy: str | None
    predicted_tre_mm: float
    limit_mm: float
    application_error_mm: float | None
    margin_mm: float | None
    verdict: MarginVerdict | None

    @classmethod
    def of(cls, row: TargetRow) -> SummarizedTarget:
        """Summarize a row of the report's table."""
        return cls(
            id=row.target,
            strategy=row.strategy,
            predicted_tre_mm=row.predicted.rms_mm,
            limit_mm=row.predicted.limit_mm,
            application_error_mm=row.error_mm,
            margin_mm=row.margin_mm,
            verdict=row.verdict,
        )


class RunSummary(Values):
    """Summary of a run: its steps, its ending, and the errors at its targets."""

    run: str
    theatre: JsonValue
    seed: JsonValue
    strategy: JsonValue
    methods: JsonValue
    began: JsonValue
    ended: str
    sentence: str
    instrument_in: str | None
    instrument_held_for: str | None
    drill_held: bool = Field(description="Whether what the assistant held is a drill.")
    work_begun: dict[str, tuple[str, ...]] = Field(description="Confirmed at each target not finished.")
    restarts: int
    resumes: int
    only_leaving: int = Field(description="Restarts only to go home or to acknowledge a fault.")
    done: tuple[str, ...]
    superseded: tuple[str, ...]
    targets: tuple[SummarizedTarget, ...]
    max_application_error_mm: float | None
    bases: BasesFigures | None
    insertions: dict[str, AssistedInsertion]
    problems: tuple[str, ...]
    arms: dict[str, str] = Field(description="Where each arm is by the journal, unless the run goes on.")
    inside: tuple[str, ...] = Field(
        description="What is or may be inside the patient by the journal of a run that stopped."
    )
    advice: str = Field(description="What to do, with the commands; empty if nothing is left to do.")
    next_command: str = Field(description="The command to type next; empty if none goes on with the run.")

    @property
    def stop_lines(self) -> tuple[str, ...]:
        """Place of each arm of a stopped run, and what may be inside the patient; empty for other runs."""
        if self.ended not in STOPPED:
            return ()
        several = len(self.arms) > 1
        places = (f"the {role if several else 'arm'} is {place}" for role, place in self.arms.items())
        return (*places, *(self.inside or ("nothing is inside the patient",)))

    @property
    def strategies(self) -> str:
        """The strategy of the run, with the targets that used another; empty if it names none."""
        return describe_strategies(str(self.strategy or ""), {one.id: one.strategy for one in self.targets})


def summarize_run(reading: RunReading) -> RunSummary:
    """Summarize a run."""
    run, truth = reading.run, reading.truth or Truth()
    ending, restarts, two_arms = ending_of(reading), run.lines(Entry.RESTARTED), read_two_arms(reading)
    opened = cast("Mapping[str, JsonValue]", run.opened)  # as it was parsed
    histories = () if ending.is_open else _read_arms(reading)
    name, resumable = escape_controls(shlex.quote(str(reading.folder))), is_resumable(reading)
    is_arm_out = any(one.place.is_out for one in histories)
    targets = tuple(map(SummarizedTarget.of, target_rows(reading, truth)))
    advice = advise(ending, resumable=resumable, run=name)
    next_command = name_next_command(ending, resumable=resumable, is_arm_out=is_arm_out, run=name)
    if run.changes and ending.word in (*STOPPED, UNSEALED):  # `resume` refuses it
        has_account = not any(change.is_account_file for change in run.changes)
        advice, next_command = advise_on_changed(may_go_home=is_arm_out and has_account, run=name)
    return RunSummary(
        run=reading.folder.resolve().name,
        theatre=opened.get("theatre"),
        seed=opened.get("seed"),
        strategy=opened.get("strategy"),
        methods=opened.get("methods"),
        began=opened.get("host_time"),
        ended=ending.word,
        sentence=ending.sentence,
        instrument_in=ending.instrument_in,
        instrument_held_for=ending.instrument_held_for,
        drill_held=any(one.held is not None and one.held.drill is not None for one in histories),
        work_begun=_list_work_begun(reading),
        restarts=len(restarts),
        resumes=resumes(run.journal),
        only_leaving=sum(ONLY_LEAVING in line for line in restarts),
        done=tuple(
            f"{one.kind}:{one.trajectory}" if one.trajectory else one.kind for one in run.valid_records
        ),
        superseded=tuple(sorted(run.superseded)),
        targets=targets,
        max_application_error_mm=max((one.application_error_mm for one in truth.targets), default=None),
        bases=two_arms.bases,
        insertions=two_arms.insertions,
        problems=(*reading.changes, *reading.problems),
        arms={one.arm: one.place.description for one in histories},
        inside=_list_inside(histories) if ending.word in STOPPED else (),
        advice=advice,
        next_command=next_command,
    )


def _read_arms(reading: RunReading) -> tuple[ArmHistory, ...]:
    """Return the history of each arm of the journal; none if another version wrote its lines."""
    noted = {MASTER, *(line.get("arm") for line in reading.run.journal)}
    try:
        arms = fold_arms(reading.run.chain, reading.run.lost)
    except JournalCorrupt:
        return ()
    return tuple(one for one in arms if one.arm in noted)


def _list_inside(histories: Sequence[ArmHistory]) -> tuple[str, ...]:
    """List what is or may be inside the patient, or in the assistant's holder, by the journal."""
    if (drill := next((one.held for one in histories if one.held and one.held.drill), None)) is not None:
        return tuple(filter(None, (describe_instrument(histories[0].place, drill),)))
    said = (
        (one.place.instrument_description, None if one.held is None else one.held.description)
        for one in histories
    )
    return tuple(what for both in said for what in both if what is not None)


def read_two_arms(reading: RunReading) -> TwoArms:
    """Read what a case with two arms has; for one arm the fields are empty."""
    known = reading.find(KnownBases)
    return TwoArms(
        bases=None if known is None else BasesFigures.model_validate(known, from_attributes=True),
        insertions={
            str(one.record.trajectory): one.result.assisted
            for one in reading.valid_results(ReachedTarget)
            if one.result.assisted is not None
        },
    )


def _list_work_begun(reading: RunReading) -> dict[str, tuple[str, ...]]:
    """List what was confirmed at each target at which the work has begun and not ended."""
    statements = {stage.task: stage.done_statement for stage in STAGES}
    begun: dict[str, list[str]] = {}
    for line in reading.run.lines(Entry.STAGE):
        if (statement := statements.get(str(line.get("task")))) is None:  # the depth stop
            continue
        done = begun.setdefault(str(line["trajectory"]), [])
        if line.get("done") and statement not in done:
            done.append(statement)
    last = statements[STAGES[-1].task]
    return {name: tuple(done) for name, done in begun.items() if last not in done}
