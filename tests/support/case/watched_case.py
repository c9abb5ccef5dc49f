"""A case that stands before its first positioning, watched by the tracker, and what happens on the way."""

from __future__ import annotations

from collections.abc import Callable

from clinical_case import FIRST, ClinicalCell
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_set_up,
    checked_tool,
    coarse,
    localized_fiducials,
    mounted_guide,
    registered_robot,
)

from procedures.engine.case import StepKey
from procedures.engine.engine import Engine
from procedures.guards import patient_watch
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.journal.results import StepResult
from procedures.steps.clinical import at_target, positioning
from procedures.steps.clinical.room import void_moved
from procedures.workcell import MountedTool
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector


def voiding(engine: Engine) -> Callable[[RonnaError], None]:
    """What the watch and the guards do when the head has moved."""
    return lambda moved: void_moved(engine.context(StepKey("global_localization")), moved)


def watched(cell: ClinicalCell, localized: tuple[StepResult, ...] = ()) -> Engine:
    """An engine that stands before the first positioning, with the guide mounted and the arm home."""
    cell.carrying(MountedTool.GUIDE).settled()
    engine = cell.begin(
        *(
            checked_set_up(cell),
            *(localized or coarse()),
            registered_robot(),
            mounted_guide(),
            checked_tool(),
            checked_paths(cell),
        ),
        *(checked_plan(), localized_fiducials(), positioning.STEP, at_target.STEP),
    )
    engine.checkpoint.watching = patient_watch(engine, voiding(engine)).watching
    engine.run_to(engine.order.sequence[8])
    return engine


def on_the_way(cell: ClinicalCell, meanwhile: Callable[[], None]) -> None:
    """Do something while the first motion is under way."""
    clear = cell.arm.blocked

    def under_way(_start: JointVector, _target: JointVector) -> bool:
        cell.arm.blocked = clear
        meanwhile()
        return False

    cell.arm.blocked = under_way


def findings(cell: ClinicalCell) -> list[str]:
    lines = read_journal(cell.folder / JOURNAL_FILE)
    return [str(line["text"]) for line in lines if line["entry"] == "finding"]


def positioned(engine: Engine) -> None:
    engine.run_step(engine.order.find(f"positioning:{FIRST}"))
