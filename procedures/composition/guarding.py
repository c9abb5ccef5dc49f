"""The guards and watches of a case: what suspends a step, before and while the arm moves."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.engine.step import StepKey
from procedures.guards import (
    GuideDisplacement,
    TrackerLink,
    UnchangedRecords,
    patient_watch,
    sight_guard,
    standing_guards,
)
from procedures.recovery.moved_cart import MovedCart
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.inputs import UnchangedInputs
from procedures.steps.clinical.room import void_moved
from ronna_hw.config import TheatreFile


def guard(engine: Engine, file: Path, theatre: TheatreFile, *, only_leaving: bool = False) -> None:
    """Every guard of a calibration or, if it has a patient, of a case that began with what the file said.

    With `only_leaving` the inputs are not compared: whatever has changed, the arm may go home.
    """
    setting, guards = engine.setting, engine.checkpoint.guards
    workcell = setting.workcell
    workcell.on_stop_failed = lambda failure: engine.events.publish(Advisory(text=failure))
    folder = engine.case.folder
    guards.extend(standing_guards(workcell, folder, setting.clock, engine.find, engine.doubt_tool))
    if not only_leaving:
        guards.append(
            UnchangedRecords(file, theatre, lambda: engine.running is not None and not workcell.place.on_axis)
        )
    link = TrackerLink(workcell.tracker, setting.memory, setting.clock.now_s)
    if setting.clinical is None:
        guards.append(link)
        return
    engine.goes_on = MovedCart(engine).agreed_to_go_on
    if not only_leaving:
        inputs = UnchangedInputs(engine, setting.clinical)
        guards.append(inputs)
        engine.recorders.append(inputs)
    void = partial(void_moved, engine.context(StepKey(GlobalLocalization.kind)))
    guards.append(
        GuideDisplacement(workcell, setting.clock, setting.memory)
    )  # before the head: it names the cause
    guards.append(sight_guard(engine, void))
    guards.append(link)  # last: it also judges the replies to the guards before it
    engine.checkpoint.watching = patient_watch(engine, void).watching
