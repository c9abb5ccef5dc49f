"""Operator orders typed at a prompt: parsing and immediate execution."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from procedures.journal.errors import StepRefused
from procedures.operator.errors import NotConfirmed, OperatorAborted
from procedures.operator.question import YES, Question, Topic
from procedures.runs import orders
from ronna_hw.command_line.errors import UsageMistake

if TYPE_CHECKING:
    from procedures.engine.case import StepKey
    from procedures.engine.engine import Engine

Say = Callable[[str], None]
# Orders that still count when the case has ended.
AT_END = (orders.ListSteps, orders.Why, orders.DryRun, orders.Help, orders.Quit)


def read_command(engine: Engine, command: str, argument: str) -> orders.Order:
    """Return the order for a command in `COMMANDS`. Raises PRO-005 for an unknown step."""
    if command == "run" and argument.startswith("to "):
        command, argument = "to", argument.removeprefix("to ").strip()
    order = orders.COMMANDS[command].order
    if "step" not in order.model_fields or (not argument and order in (orders.Why, orders.DryRun)):
        return order()
    return order.model_validate({"step": str(engine.order.find(argument))})


def carry_out(engine: Engine, order: orders.Order, say: Say, by: str = "") -> None:
    """Carry out an order typed at a prompt by the person `by`. Raises the errors of steps."""
    find = engine.order.find
    match order:
        case orders.ListSteps():
            _list_steps(engine, say)
        case orders.Next():
            if engine.upcoming is None:
                say(_describe_nothing_upcoming(engine))
            else:
                engine.run_step(engine.upcoming)
        case orders.Run(step=step) if not engine.case.stands(find(step)):
            engine.run_step(find(step))
        case orders.Run(step=step) | orders.Repeat(step=step):
            _repeat(engine, find(step), say)
        case orders.RunTo(step=step):
            if refused := engine.course.why_not_up_to(find(step)):
                say(refused + (_repetition(engine, find(step)) if engine.case.stands(find(step)) else ""))
            else:
                engine.run_to(find(step))
        case orders.Why(step=step):
            key = engine.upcoming if step is None else find(step)
            if key is None:
                say(_describe_nothing_upcoming(engine))
            else:
                _explain(engine, key, say)
        case orders.DryRun(step=step):
            _dry_run(engine, _find_step_or_next(engine, step), say)
        case orders.Pause() if engine.machine.ended:
            say(f"nothing to pause: {_describe_nothing_upcoming(engine)}")
        case orders.Pause():
            engine.checkpoint.pause()
            before = "the arm moves" if engine.upcoming is None else "the next step"
            say(f"the case will pause before {before}; while a step runs, Ctrl-C pauses it")
        case orders.Stop():
            say("no step is running and the arm is at rest; quit leaves the case")
        case orders.Resume():
            _resume(engine, say)
        case orders.Home():
            engine.retreat_home()
            say(f"{engine.setting.workcell.phrases.are} parked")
        case orders.Acknowledge():
            _acknowledge(engine, by, say)
        case orders.Abort():
            if not engine.machine.ended:
                engine.leave_head()
            engine.abort()
            raise OperatorAborted("the operator ended the procedure")
        case orders.Help():
            for name, rule in orders.COMMANDS.items():
                if engine.machine.ended and rule.order not in AT_END:
                    continue
                say(f"{f'{name} {rule.argument}'.strip():<22} {rule.does}")


def _list_steps(engine: Engine, say: Say) -> None:
    width = max(len(engine.course.status(key)) for key in engine.order.sequence)
    for key in engine.order.sequence:
        spec = engine.order.spec(key)
        asks = f"; asks {', '.join(spec.asks)}" if spec.asks and not engine.case.stands(key) else ""
        say(f"{engine.course.status(key):<{width}}  {key!s:<24} {spec.title}{asks}")


def _repeat(engine: Engine, key: StepKey, say: Say) -> None:
    if not engine.case.stands(key):
        raise StepRefused(f"{key} is not done, so it cannot be repeated", action="Use run or to instead.")
    if not engine.why_refused(key):
        superseded_names = ", ".join(record.identifier for record in engine.course.records_superseded_by(key))
        say(f"a new result of {key} supersedes {superseded_names}")
        if engine.ask(Question(Topic.REPEAT, f"repeat {key}", f"supersedes {superseded_names}")) != YES:
            raise NotConfirmed(f"the operator did not confirm: repeat {key}", got=superseded_names)
    engine.run_step(key)


def why_not_skipped(engine: Engine, step: str) -> str:
    """Explain why this step cannot be skipped. Raises PRO-005 for an unknown step."""
    key = _find_step_or_next(engine, step or None)
    result = engine.order.spec(key).result
    readers = [step.name for step in engine.order.steps if result in step.reads]
    needed = "needs" if len(readers) == 1 else "need"
    why = (
        f"{', '.join(readers)} {needed} its result"
        if readers
        else "the case cannot finish without its result"
    )
    return f"{key} cannot be skipped: {why}. A trajectory can be left out when the case asks about it."


def _explain(engine: Engine, key: StepKey, say: Say) -> None:
    if engine.case.stands(key):
        say(f"{key} is done and its result is valid{_repetition(engine, key)}")
        return
    unmet = engine.why_refused(key)
    say(f"{key}: " + ("can start" if not unmet else "refused: " + "; ".join(unmet)))
    from procedures.steps.catalogue import list_questions

    for question in list_questions(engine.order.spec(key)):
        say(f"  asks {question}")


def _repetition(engine: Engine, key: StepKey) -> str:
    """Describe how to repeat a finished step, or why it cannot be repeated now."""
    unmet = engine.why_refused(key)
    return f"; it cannot be repeated now: {'; '.join(unmet)}" if unmet else f"; back {key} repeats it"


def _dry_run(engine: Engine, key: StepKey, say: Say) -> None:
    from procedures.steps.dry_run import describe_planned_motions

    _explain(engine, key, say)
    if not engine.order.spec(key).moves_an_arm:
        say("this step moves nothing")
        return
    motions = describe_planned_motions(engine.case, key, engine.setting)
    if motions is None:
        say("this step moves the arm; its motions are known after path_check")
        return
    for motion in motions:
        say(f"  {motion}")


def _resume(engine: Engine, say: Say) -> None:
    withdrawn = engine.checkpoint.withdraw_pause()
    state = "the pause is withdrawn" if withdrawn else "nothing is paused"
    if engine.checkpoint.firm:
        state = "the arm was stopped: that is asked about when the next step begins"
    faults = tuple(engine.faults.descriptions.values())
    say("; ".join((state, *(faults or (continue_hint(engine, "next or to continues"),)))))


def continue_hint(engine: Engine, commands: str) -> str:
    """Return the hint that `commands` continue the case, or what to do if no step remains."""
    is_last = engine.machine.ended or engine.upcoming is None
    return _describe_nothing_upcoming(engine) if is_last else commands


def _acknowledge(engine: Engine, by: str, say: Say) -> None:
    if not by:
        raise UsageMistake("acknowledge needs your name", action="Type: acknowledge YOUR-NAME.")
    if by in engine.setting.workcell.devices:
        raise UsageMistake(
            f"{by} is a device, expected the name of the person who acknowledges",
            action="acknowledge YOUR-NAME recovers every device that is in fault.",
        )
    recovered = engine.faults.acknowledge(by)
    recoveries = [f"{role}, {fault}" for role, fault in recovered.items()]
    say(f"acknowledged by {by}: {'; '.join(recoveries)}" if recoveries else "no device is in fault")


def _find_step_or_next(engine: Engine, step: str | None) -> StepKey:
    if step is not None:
        return engine.order.find(step)
    if engine.upcoming is None:
        raise StepRefused(_describe_nothing_upcoming(engine), action="Name a step.")
    return engine.upcoming


def _describe_nothing_upcoming(engine: Engine) -> str:
    if engine.machine.ended and not engine.over:
        return f"the case has ended: {engine.machine.state}"
    return (
        "the case is finished"
        if engine.over
        else f"every step is done; home brings {engine.setting.workcell.phrases.arms} home"
    )
