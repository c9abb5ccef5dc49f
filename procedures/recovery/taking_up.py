"""Takes a run up again: nothing moves before everything was read again, compared, and accepted.

Then the instrument comes out along its axis, if it is inside, and the arm goes home the way it came; there
the tracker has its sight, and what it could not see before is compared. Then every step that does not stand
is run, planned anew from where the arm is.
"""

from __future__ import annotations

from dataclasses import replace

from procedures.engine.engine import Engine
from procedures.engine.errors import RecoveryRefused
from procedures.engine.journal import Entry
from procedures.engine.left_run import LeftRun, step_key
from procedures.engine.operator import YES, Question, Topic
from procedures.engine.step import StepKey
from procedures.recovery.comparison import Comparison
from procedures.recovery.devices import compare_devices
from procedures.recovery.inputs import compare_inputs
from procedures.recovery.instrument import instrument_on_an_axis
from procedures.recovery.room import compare_room
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.head_surroundings import surround_guide, surround_stereo_head
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.registration import RegisteredRobot
from procedures.steps.clinical.relocalization import Relocalization
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.workcell import MountedTool
from procedures.workcell.left_arm import left_arm


def recover(engine: Engine, left: LeftRun) -> None:
    """Bring an engine that begins in recovery to where its next step may begin.

    Raises PRO-032 for a difference and unless the operator accepts, and what devices and motions raise.
    """
    comparison = Comparison()
    compare_inputs(engine, comparison)
    workcell = engine.setting.workcell
    stored = engine.case.find(CheckedSetUp, None)
    seen = True
    if stored is not None:
        arm = left_arm(left.run.journal)
        workcell.take_up(arm, stored.result.home_rad)
        compare_devices(engine, stored.result, comparison, exchange_begun=_exchange_begun(engine, left))
        if arm.insertion is None and (found := instrument_on_an_axis(engine)) is not None:
            insertion, beyond_mm = found
            workcell.take_up(replace(arm, insertion=insertion, withdrawn_from=None), stored.result.home_rad)
            comparison.note(
                f"the tip is {beyond_mm:.0f} mm along {insertion.trajectory}: the instrument counts as inside"
            )
        seen = bool(comparison.differences) or compare_room(engine, comparison)
        if not seen:
            comparison.note(
                "patient and robot base: out of the tracker's sight; compared when the arm is home"
            )
    _conclude(engine, comparison)
    question = Question(
        Topic.RESUME, "take the run up again", "; ".join((*_redone(engine), *comparison.findings))
    )
    if engine.questions.ask(question) != YES:
        raise RecoveryRefused(
            "the operator did not accept what was found", action="Resume again when it may go on."
        )
    engine.accept()
    if stored is None:
        return
    _surround(engine)
    moved = _way_out(engine)
    if (moved or not seen) and engine.upcoming is not None:
        workcell.rest()  # the tracker measures while the arm's stream is off
        again = Comparison()
        if not compare_room(engine, again):
            again.differs("patient", "at least three spheres in sight", "fewer, with the arm home")
        _conclude(engine, again)


def _conclude(engine: Engine, comparison: Comparison) -> None:
    engine.found(comparison.findings, comparison.differences)
    if comparison.differences:
        raise RecoveryRefused("the run cannot be taken up again: " + "; ".join(comparison.differences))


def _exchange_begun(engine: Engine, left: LeftRun) -> bool:
    """Whether somebody was asked to change the tool, and no result says that it was done."""
    name = MountedGuide.kind
    begun = any(line["entry"] == Entry.INTENT and step_key(line).name == name for line in left.run.journal)
    return begun and not engine.case.stands(StepKey(name))


def _redone(engine: Engine) -> tuple[str, ...]:
    """What will happen, in the order in which it will."""
    workcell = engine.setting.workcell
    first = []
    if (trajectory := engine.instrument_in) is not None:
        first.append(f"first the instrument comes out of {trajectory} along its axis")
    if engine.case.find(CheckedSetUp, None) is not None and not workcell.at_home:
        first.append("the arm goes home the way it came")
    steps = [str(key) for key in engine.order.sequence if engine.status(key) not in ("done", "left out")]
    return (*first, f"then to do: {', '.join(steps) or 'nothing'}")


def _surround(engine: Engine) -> None:
    """Say where the head is, before anything moves. Where that is not known yet, the arm is still home."""
    workcell, case = engine.setting.workcell, engine.case
    if case.find(Correspondence, None) is None:
        if not workcell.at_home:
            raise RecoveryRefused(
                "the arm is not home, and no result says where the head is",
                action="Move the arm home by hand at the controller, then resume again.",
            )
        return
    keys = engine.order.sequence
    if workcell.tool is MountedTool.GUIDE:
        inside = engine.instrument_in
        for key in keys:
            wanted = key.name == PositionedGuide.kind and inside in (None, key.trajectory)
            if (
                wanted
                and case.stands(StepKey(MountedGuide.kind))
                and case.find(RegisteredRobot, key.trajectory)
            ):
                context = engine.context(key)
                surround_guide(context, context.result(RegisteredRobot).robot_from_ct.transform)
                return
    elif workcell.tool is MountedTool.STEREO_HEAD:
        surround_stereo_head(engine.context(next(key for key in keys if key.name == Relocalization.kind)))


def _way_out(engine: Engine) -> bool:
    """Bring the instrument out and the arm home; whether anything moved."""
    workcell = engine.setting.workcell
    following = engine.upcoming
    if (
        engine.instrument_in is not None
        and following is not None
        and engine.order.spec(following).moves
        and not engine.why_refused(following)
    ):
        engine.run_step(following)  # the work at the target is done: what remains is the retreat itself
    if engine.instrument_in is None and workcell.at_home:
        return False
    engine.retreat_home()
    return True
