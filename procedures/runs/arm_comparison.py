"""Comparison of the arms' places with the journal and, in the guide, with the tracked frames.

What the guide's pose tells is assumed where the journal's lost end may have said it.
"""

from __future__ import annotations

from typing import TypeVar

from procedures.engine.engine import Engine
from procedures.engine.questions import IN_DIVOT, IN_GAUGE
from procedures.guards.errors import InsertionDisturbed
from procedures.guards.room_watch import RoomWatch
from procedures.journal.results import StepResult, parse_record
from procedures.runs import way_out
from procedures.runs.comparison import Comparison
from procedures.runs.interrupted_run import InterruptedRun
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.localized_room import build_watch
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import KnownBases, RegisteredRobot
from procedures.steps.clinical.room import targets_mm
from procedures.steps.clinical.two_arms.seen_on_axis import (
    LOOK_AT_CART,
    NotCompared,
    look_before_retreat,
    require_seen_on_axis,
)
from procedures.workcell.arm_history import fold_history
from procedures.workcell.assistant import Assistant
from procedures.workcell.errors import TipOffAxis
from ronna_hw.records import Record
from ronna_hw.roles import ASSISTANT

R = TypeVar("R", bound=StepResult)


def compare_arms(engine: Engine, previous: InterruptedRun, comparison: Comparison) -> None:
    """Compare where each arm is with the journal; refuse a way out that nobody can check.

    The devices are configured. An instrument that may be in the guide is assumed to be inside.
    """
    for assistant in engine.setting.workcell.assistants:
        _compare_assistant(engine, assistant, previous, comparison)
    _compare_guide(engine, comparison)


def _compare_guide(engine: Engine, comparison: Comparison) -> None:
    """Infer from the guide's pose what may be inside."""
    master = engine.setting.workcell.master
    if not master.place.is_on_axis and (found := way_out.find_guide_axis(engine)) is not None:
        axis, travel_mm = found
        master.record_found_on_axis(axis)  # the lost lines may also have said that an instrument goes in
        comparison.warnings.append(
            f"the guide is {travel_mm:.0f} mm along {axis.trajectory}: an instrument is assumed to be inside"
        )
    elif master.instrument.inside is None and way_out.is_guide_in_gauge(engine):
        master.instrument.record_assumed(IN_GAUGE)
        comparison.warnings.append("the guide is at the gauge: the mandrel is assumed to be inside")
    elif master.instrument.inside is None and way_out.is_guide_at_divot(engine):
        master.instrument.record_assumed(IN_DIVOT)
        comparison.warnings.append("the guide is at the divot, which is assumed to be raised")
    if master.place.assumed and master.instrument.inside in engine.order.trajectories:
        master.instrument.stages.record_doubt(str(master.instrument.inside))


def _tell_tip(assistant: Assistant, travelled_mm: float) -> str:
    """Tell how far behind the entry the tip of a drill is that may have drilled, or ''."""
    held = assistant.history.held
    if held is None or held.drill is None or not held.drill.may_turn:
        return ""
    return f", the tip of the drill {travelled_mm - held.drill.entry_mm:.1f} mm behind the entry"


def _compare_assistant(
    engine: Engine, assistant: Assistant, previous: InterruptedRun, comparison: Comparison
) -> None:
    workcell = engine.setting.workcell
    if (axis := assistant.place.axis) is not None:
        try:
            travelled_mm = assistant.require_on_axis()
        except TipOffAxis as problem:
            comparison.add_difference("the assistant", f"on the axis of {axis.trajectory}", problem)
        else:
            comparison.notes.append(
                f"assistant, by its joints: {travelled_mm:.0f} of the {axis.travel_mm:.0f} mm along the bore "
                f"at {axis.trajectory} are gone{_tell_tip(assistant, travelled_mm)}"
            )
            _compare_with_frame(engine, axis.trajectory, comparison)
    if assistant.history.base is None and workcell.is_any_arm_out:
        comparison.differences.append(
            "an arm is away from its home, and the journal does not say where the assistant stands: jog both "
            "arms home with their pendants, one at a time"
        )
    was_home = fold_history(previous.run.chain, previous.run.lost, ASSISTANT).place.is_home
    if was_home and assistant.place.is_out:
        comparison.warnings.append("the assistant was at its home and is not any more: somebody has moved it")


def look_with_instrument_in_guide(engine: Engine) -> str:
    """Look whether a cart was displaced before the assistant is sent home; as `look_before_retreat`."""
    return look_before_retreat(engine.setting.workcell, _watch_with_bases(engine))


def _compare_with_frame(engine: Engine, trajectory: str, comparison: Comparison) -> None:
    """Refuse the way out if the tracker sees the assistant beside it; where it sees too little, warn."""
    try:
        found = require_seen_on_axis(engine.setting.workcell, _watch_with_bases(engine))
    except InsertionDisturbed as displaced:
        comparison.differences.append(str(displaced))
    except NotCompared as unknown:
        comparison.warnings.append(f"{unknown}: {LOOK_AT_CART}")
    else:
        comparison.notes.append(f"assistant, on the axis of {trajectory}: the instrument is {found}")


def _watch_with_bases(engine: Engine) -> RoomWatch | None:
    """Return the watch over the last localization, also if void: it tells how the arms stood then."""
    bases, localized = _find_last(engine, KnownBases), _find_last(engine, GlobalLocalization)
    if bases is None or localized is None:
        return None
    matched = _find_last(engine, Correspondence)
    workcell, settings = engine.setting.workcell, engine.setting.settings
    pairs = None if matched is None else matched[1].pairs
    checked, registered = _find_last(engine, CheckedPlan), _find_last(engine, RegisteredRobot)
    points_mm = targets_mm(checked[1], matched[1]) if checked and matched else {}
    followed = None if registered is None else registered[1]
    name = localized[0].identifier
    return build_watch(workcell, settings, name, localized[1], pairs, points_mm, bases[1], followed)


def _find_last(engine: Engine, model: type[R]) -> tuple[Record, R] | None:
    """Return the last result, also if void: it tells how the arms stood when the instrument was led in."""
    made = [record for record in engine.case.records if record.kind == model.kind]
    return (made[-1], parse_record(made[-1], model)) if made else None
