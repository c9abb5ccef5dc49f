"""Recovery of an interrupted run: everything is read, compared and accepted before anything moves.

Then an instrument is taken out by hand, the guide retreats along its axis, and the arm goes home. There the
tracker has a clear view, and the rest is compared. Then every step without a valid result is run, re-planned
from the arm's position.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from procedures.engine.case import StepKey
from procedures.engine.engine import Engine
from procedures.engine.errors import RECOVERY_REFUSED
from procedures.engine.questions import removal_words, resting_words
from procedures.engine.run_folder import step_key
from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry
from procedures.operator.question import YES, Question, Topic
from procedures.runs import way_out
from procedures.runs.arm_comparison import compare_arms
from procedures.runs.arm_notes import NOT_KNOWN
from procedures.runs.comparison import Comparison, compare_devices, compare_inputs, compare_room
from procedures.runs.interrupted_run import InterruptedRun
from procedures.runs.request_file import read_request
from procedures.runs.theatre_history import describe_updates_since, find_state, read_states
from procedures.steps.calibration.tip_readings import ObservedStand, TipReadings
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import Relocalization
from procedures.steps.clinical.room import void_moved
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.work_progress import STAGES, work_begun_elsewhere
from ronna_hw.devices.capabilities import MESSAGES
from ronna_hw.errors import RonnaError
from ronna_hw.text import format_names

EXCHANGES = (MountedGuide.kind, TipReadings.kind)  # steps in which the guide is mounted
RESTORE = "The arm is home. Restore the recorded state and resume again, or start a new run."
UNATTENDED = "the program was not running"  # leaves a check of the mounted tool in doubt
LOOKS = (Relocalization.kind, ObservedStand.kind)  # steps that the head must have finished before


def recover(engine: Engine, previous: InterruptedRun) -> None:
    """Compare everything with the records, bring the arm home, and prepare for the next step.

    Raises PRO-032 for a difference, or if the operator does not accept, and errors of devices and motions.
    """
    comparison = Comparison(warnings=list(previous.contradictions))
    compare_inputs(engine, comparison, previous.plan_sha256)
    _doubt_tool(engine, comparison)
    stored = engine.case.find(CheckedSetUp, None)
    seen = True
    if stored is not None:
        _restore_arm(engine, previous, stored.result, comparison)
        seen = bool(comparison.differences) or compare_room(engine, comparison)
        if not seen:
            comparison.notes.append(
                "patient and robot base: not visible to the tracker; compared once "
                f"{engine.setting.workcell.phrases.are} home"
            )
    _doubt_work(engine, previous)  # after the arm's history is restored
    _require_acceptance(
        engine,
        comparison,
        "May the run go on from here?",
        (*_list_first_moves(engine), _describe_remaining_steps(engine)),
    )
    if stored is None:
        return
    _void_moved(engine, comparison)
    way_out.surround_arms(engine)
    moved = _move_out(engine)
    if (moved or not seen) and engine.upcoming is not None:
        engine.setting.workcell.rest()  # the tracker measures while the arm's stream is off
        again = Comparison()
        if not compare_room(engine, again):
            again.add_difference("patient", "at least three spheres in view", "fewer, with the arm home")
        _conclude(engine, again, RESTORE if moved else None)
        _void_moved(engine, again)


def _void_moved(engine: Engine, comparison: Comparison) -> None:
    """Void what depends on anything that has moved meanwhile."""
    if comparison.moved is not None:
        void_moved(engine.context(engine.order.sequence[0]), comparison.moved)


def _doubt_tool(engine: Engine, comparison: Comparison) -> None:
    """Cast doubt on the tool checks, since a tool number does not show whether the tool was touched."""
    for key in engine.order.checks_of_tool:
        engine.case.doubt(key, UNATTENDED)
    for key in engine.course.checks_in_doubt:
        comparison.notes.append(
            f"the mounted tool may have been touched meanwhile: {key} is repeated before it is used"
        )
    for fault, steps in _list_doubted_localizations(engine).items():
        comparison.warnings.append(
            f"{fault} came after {format_names(steps)}: whether they are kept is asked before they are used"
        )


def _list_doubted_localizations(engine: Engine) -> dict[str, list[str]]:
    """Return the localizations that are older than a fault of the arm, by that fault."""
    doubted: dict[str, list[str]] = {}
    for key in (*engine.order.localizations, *engine.order.relations_of_arms):
        if (fault := engine.case.doubt_at(key)) is not None:
            doubted.setdefault(fault, []).append(str(key))
    return doubted


def _doubt_work(engine: Engine, previous: InterruptedRun) -> None:
    """Cast doubt on the work at targets that an orphaned record reports as reached: every stage was done."""
    stages = engine.setting.workcell.master.instrument.stages
    for trajectory in previous.list_unrecorded_work(engine.order, ReachedTarget.kind):
        stages.record_doubt(trajectory)
        for stage in STAGES:
            if stage.task not in stages.tasks_at(trajectory):
                stages.record_done(trajectory, stage.task)


def bring_home(engine: Engine, previous: InterruptedRun) -> bool:
    """Request instrument removal and bring the arm home; return whether anything moved.

    The run stays as it is. Only the arm is needed, and only conditions of the way home are compared. Raises
    PRO-001 if the devices were never set up, PRO-032 like `recover`, and the arm's errors.
    """
    comparison = Comparison(warnings=list(previous.contradictions))
    _restore_arm(engine, previous, engine.case.get(CheckedSetUp).result, comparison, only_leaving=True)
    workcell = engine.setting.workcell
    comparison.notes.append(
        f"patient and robot base: not compared: {workcell.phrases.going_home}, no further"
    )
    for change in previous.run.changes:
        comparison.warnings.append(f"not as the run left it: {change}")
    if not (first := _list_first_moves(engine)):
        _conclude(engine, comparison)
        return False
    _require_acceptance(engine, comparison, f"May {workcell.phrases.arms} go home from here?", first)
    way_out.surround_arms(engine)
    engine.retreat_home()
    return True


def _restore_arm(
    engine: Engine,
    previous: InterruptedRun,
    set_up: CheckedSetUp,
    comparison: Comparison,
    *,
    only_leaving: bool = False,
) -> None:
    """Restore the arm's history, and compare every device and the place of each arm."""
    workcell, master = engine.setting.workcell, engine.setting.workcell.master
    master.restore_history(previous.arm)
    for role, home_rad in set_up.homes_rad.items():
        workcell.arms[role].restore_home(home_rad)
    if (held := workcell.held_instrument) is not None and held.may_turn:
        comparison.warnings.append(held.description)
    if (inside := master.place.instrument_may_be_inside) is not None:
        spoken = "a drill" if held is not None and held.drill is not None else "an instrument"
        comparison.warnings.append(
            f"the journal does not rule out {spoken} in {inside}: one is assumed to be inside"
            if master.place.assumed
            else f"{spoken} is in {inside}, as the journal says"
        )
    begun = _has_exchange_begun(engine, previous)
    compare_devices(engine, set_up, comparison, exchange_begun=begun, only_leaving=only_leaving)
    if comparison.differences and (updates := _describe_theatre_updates(previous)) is not None:
        comparison.differences.append(updates)
    _compare_last_to_move(engine, comparison)
    compare_arms(engine, previous, comparison)


def _describe_theatre_updates(previous: InterruptedRun) -> str | None:
    """Describe the theatre file's updates since a run, and the command that undoes them, as far as known."""
    recorded = previous.theatre_sha256
    config = None if recorded is None else read_request(previous.folder).config
    if config is None or recorded is None:
        return None
    try:
        updates = describe_updates_since(config, recorded)
        number = find_state(read_states(config), recorded)
    except (OSError, RonnaError):  # it explains the differences, which are said in any case
        return None
    if updates is None or number is None:
        return updates
    options = f"{shlex.quote(str(config))} --restore {number} --by 'YOUR NAME'"
    return f"{updates}; ronna-procedure theatre-history {options} puts the former records back"


def _compare_last_to_move(engine: Engine, comparison: Comparison) -> None:
    """Refuse an arm that another run left away from home, as only that run knows the way back.

    An arm that is at this run's home has been jogged there since.
    """
    if (not_home := engine.setting.arm_not_home) is None:
        return
    if engine.setting.workcell.master.place.is_home:
        comparison.warnings.append(f"{not_home}; it is at the home of this run now")
    elif not_home == NOT_KNOWN:  # it may have been this very run: the operator decides
        comparison.warnings.append(not_home)
    else:
        comparison.differences.append(not_home)


def _require_acceptance(engine: Engine, comparison: Comparison, subject: str, order: Sequence[str]) -> None:
    """Ask the operator to accept the findings and the next actions. Raises PRO-032."""
    for begun in work_begun_elsewhere(engine):
        comparison.warnings.append(begun)
    if way_out.has_head_moved(engine):
        comparison.warnings.append(way_out.MOVED_SINCE)
    _conclude(engine, comparison)
    _require_ready(engine)
    question = Question(Topic.RESUME, subject, comparison.format_lines(order))
    if engine.ask(question) != YES:
        late_s = engine.questions.unanswered_s
        found = "; ".join([*comparison.warnings, *comparison.notes])
        raise RECOVERY_REFUSED(
            "the operator did not accept the findings" if late_s is None else "the time to answer ran out",
            expected=None if late_s is None else "that the findings are accepted",
            got=found or None,
            limit=None if late_s is None else f"{late_s:g} s",
            action="Nothing was moved. Repeat the command when the case may continue. A script accepts with "
            "--accept, in a simulated theatre alone.",
        )
    engine.accept()


def _require_ready(engine: Engine) -> None:
    """Raise PRO-001 if any device is not ready for motion, before asking the operator."""
    seen = [(role, device.observe()) for role, device in engine.setting.workcell.devices.items()]
    blocking = [(role, fact) for role, known in seen for fact in known.says if not fact.ready]
    if not blocking:
        return
    reasons = [f"{role}, {fact.name}: {fact.found}" for role, fact in blocking]
    first = [fact.advice for _, fact in blocking if fact.name != MESSAGES]
    run = shlex.quote(str(engine.case.folder))
    acknowledge = f"ronna-procedure acknowledge {run} --by 'YOUR NAME'"
    raise StepRefused(
        f"nothing may move yet: {'; '.join(reasons)}",
        action=" ".join((*first, f"Nothing was moved. Run {acknowledge}, then this command again.")),
    )


def _conclude(engine: Engine, comparison: Comparison, action: str | None = None) -> None:
    """Record the findings. Raises PRO-032 if there are differences."""
    engine.found(comparison.findings, comparison.differences)
    if comparison.differences:
        by_other = engine.setting.arm_not_home in comparison.differences
        raise RECOVERY_REFUSED(
            "the run cannot be resumed: " + "; ".join(comparison.differences),
            action="Nothing was moved. Bring the arm home as said, then repeat this command."
            if by_other
            else action,
        )


def _has_exchange_begun(engine: Engine, previous: InterruptedRun) -> bool:
    """Whether a tool change was requested but not confirmed by a result.

    If the journal's end is lost and every sphere is localized, the lost lines may have requested it.
    """
    exchange = next((key for key in engine.order.sequence if key.name in EXCHANGES), None)
    if exchange is None or engine.case.stands(exchange):
        return False
    begun = any(line["entry"] == Entry.INTENT and step_key(line) == exchange for line in previous.run.journal)
    looks = [key for key in engine.order.sequence if key.name in LOOKS]
    return begun or (previous.ever_lost_lines and all(map(engine.case.stands, looks)))


def _list_first_moves(engine: Engine) -> tuple[str, ...]:
    """Describe the actions that precede the first step."""
    workcell = engine.setting.workcell
    held = workcell.held_instrument
    name = "instrument" if held is None else held.name
    first = [f"first, by hand: {resting_words(held)}"] if held is not None and held.may_turn else []
    first += [
        f"the {arm.spoken_name} leads the {name} straight out of {arm.place.trajectory}"
        for arm in workcell.outermost_first
        if arm.leads_instrument
    ]
    by_hand = [] if (place := engine.instrument_in) is None else [removal_words(place, held)]
    if held is not None:
        by_hand.append(f"take the {name} for {held.trajectory} out of the assistant's holder")
    for words in by_hand:
        first.append(f"{'then' if first else 'first'}, by hand: {words}")
    return (*first, *(words for arm in workcell.outermost_first for words in arm.way_home))


def _describe_remaining_steps(engine: Engine) -> str:
    course = engine.course
    gone = (record for key in course.checks_in_doubt for record in course.records_voided_by(key))
    again = {StepKey(record.kind, record.trajectory) for record in gone}
    keys = () if course.over else engine.order.sequence
    steps = [str(key) for key in keys if key in again or not course.is_settled(key)]
    return f"remaining steps: {', '.join(steps) or 'none'}"


def _move_out(engine: Engine) -> bool:
    """Request instrument removal, retreat and bring the arm home; return whether anything moved."""
    *reaching_in, master = engine.setting.workcell.outermost_first
    if any(arm.place.is_out for arm in reaching_in):
        engine.retreat_home()  # first whatever may hold an instrument in the guide
        return True
    engine.questions.request_instrument_removal()
    following = engine.upcoming if master.place.is_on_axis else None
    if following is not None and engine.order.spec(following).moves and not engine.why_refused(following):
        engine.run_step(following)  # the work at the target is done: only the retreat itself remains
    if master.place.is_home:
        return False
    engine.retreat_home()
    return True
