"""Commands for a case run by hand, one per line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from procedures.journal.errors import StepRefused
from procedures.operator.checkpoint import ABORT, GO_ON
from procedures.operator.errors import NotConfirmed, OperatorAborted
from procedures.operator.question import YES, Question, Topic
from ronna_hw.command_line.errors import UsageMistake

if TYPE_CHECKING:
    from procedures.engine.case import StepKey
    from procedures.engine.engine import Engine

Say = Callable[[str], None]
LOOKING = ("list", "why", "dry", "help")  # also while the case is paused
AT_PAUSE = {"resume": GO_ON, GO_ON: GO_ON, ABORT: ABORT}


@dataclass(frozen=True)
class Command:
    """One command: its argument, its purpose, and its work."""

    argument: str
    does: str
    work: Callable[[Engine, str, Say], None]


def _list(engine: Engine, _argument: str, say: Say) -> None:
    width = max(len(engine.course.status(key)) for key in engine.order.sequence)
    for key in engine.order.sequence:
        spec = engine.order.spec(key)
        asks = f"; asks {', '.join(spec.asks)}" if spec.asks and not engine.case.stands(key) else ""
        say(f"{engine.course.status(key):<{width}}  {key!s:<24} {spec.title}{asks}")


def _next(engine: Engine, _argument: str, say: Say) -> None:
    if engine.upcoming is None:
        say(_nothing_upcoming(engine))
        return
    engine.run_step(engine.upcoming)


def _run(engine: Engine, argument: str, say: Say) -> None:
    if argument.startswith("to "):
        _to(engine, argument.removeprefix("to ").strip(), say)
        return
    key = engine.order.find(argument)
    if engine.case.stands(key):
        _back(engine, argument, say)
    else:
        engine.run_step(key)


def _to(engine: Engine, argument: str, say: Say) -> None:
    key = engine.order.find(argument)
    if refused := engine.course.why_not_up_to(key):
        say(f"{refused}; back {key} repeats it" if engine.case.stands(key) else refused)
        return
    engine.run_to(key)


def _back(engine: Engine, argument: str, say: Say) -> None:
    key = engine.order.find(argument)
    if not engine.case.stands(key):
        raise StepRefused(f"{key} is not done, so it cannot be repeated", action="Use run or to instead.")
    if not engine.why_refused(key):
        gone = ", ".join(record.identifier for record in engine.course.superseded_by(key))
        say(f"a new result of {key} supersedes {gone}")
        if engine.ask(Question(Topic.REPEAT, f"repeat {key}", f"supersedes {gone}")) != YES:
            raise NotConfirmed(f"the operator did not confirm: repeat {key}", got=gone)
    engine.run_step(key)


def _skip(engine: Engine, argument: str, _say: Say) -> None:
    key = _named(engine, argument)
    result = engine.order.spec(key).result
    readers = [step.name for step in engine.order.steps if result in step.reads]
    needed = "needs" if len(readers) == 1 else "need"
    why = (
        f"{', '.join(readers)} {needed} its result"
        if readers
        else "the case cannot finish without its result"
    )
    raise StepRefused(
        f"{key} cannot be skipped: {why}", action="A trajectory can be left out when the case asks about it."
    )


def _why(engine: Engine, argument: str, say: Say) -> None:
    key = engine.order.find(argument) if argument else engine.upcoming
    if key is None:
        say(_nothing_upcoming(engine))
        return
    if engine.case.stands(key):
        say(f"{key} is done and its result is valid; back {key} repeats it")
        return
    unmet = engine.why_refused(key)
    say(f"{key}: " + ("can start" if not unmet else "refused: " + "; ".join(unmet)))
    from procedures.steps.catalogue import planned_questions

    for question in planned_questions(engine.order.spec(key)):
        say(f"  asks {question}")


def _dry(engine: Engine, argument: str, say: Say) -> None:
    from procedures.steps.dry_run import planned_motions

    key = _named(engine, argument)
    _why(engine, str(key), say)
    if not engine.order.spec(key).moves:
        say("this step moves nothing")
        return
    motions = planned_motions(engine.case, key, engine.setting)
    if motions is None:
        say("this step moves the arm; its motions are known after path_check")
        return
    for motion in motions:
        say(f"  {motion}")


def _pause(engine: Engine, _argument: str, say: Say) -> None:
    engine.checkpoint.pause()
    say("the case will pause before the next step; while a step runs, Ctrl-C pauses it")


def _stop(_engine: Engine, _argument: str, say: Say) -> None:
    say("no step is running and the arm is at rest; quit leaves the case")


def _resume(engine: Engine, _argument: str, say: Say) -> None:
    withdrawn = engine.checkpoint.withdraw_pause()
    state = "the pause is withdrawn" if withdrawn else "nothing is paused"
    if engine.checkpoint.firm:
        state = "the arm was stopped: that is asked about when the next step begins"
    faults = tuple(engine.faults.described.values())
    say("; ".join((state, *(faults or ("next or to continues",)))))


def _home(engine: Engine, _argument: str, say: Say) -> None:
    engine.retreat_home()
    say("the arm is parked")


def _acknowledge(engine: Engine, argument: str, say: Say) -> None:
    if not argument:
        raise UsageMistake("acknowledge needs your name", action="Type: acknowledge YOUR-NAME.")
    if argument in engine.setting.workcell.devices:
        raise UsageMistake(
            f"{argument} is a device, expected the name of the person who acknowledges",
            action="acknowledge YOUR-NAME recovers every device that is in fault.",
        )
    recovered = engine.faults.acknowledge(argument)
    done = [f"{role}, {fault}" for role, fault in recovered.items()]
    say(f"acknowledged by {argument}: {'; '.join(done)}" if done else "no device is in fault")


def _abort(engine: Engine, _argument: str, _say: Say) -> None:
    if not engine.machine.ended:
        engine.leave_head()
    engine.abort()
    raise OperatorAborted("the operator ended the procedure", action="Start a new run when ready.")


def _help(_engine: Engine, _argument: str, say: Say) -> None:
    for name, command in COMMANDS.items():
        say(f"{f'{name} {command.argument}'.strip():<22} {command.does}")
    say(f"{'quit':<22} leave the case; not possible while an instrument is inside")


def _named(engine: Engine, argument: str) -> StepKey:
    if argument:
        return engine.order.find(argument)
    if engine.upcoming is None:
        raise StepRefused(_nothing_upcoming(engine), action="Name a step.")
    return engine.upcoming


def _nothing_upcoming(engine: Engine) -> str:
    return "the case is finished" if engine.over else "every step is done; home brings the arm home"


COMMANDS: dict[str, Command] = {
    "list": Command("", "every step and its status", _list),
    "next": Command("", "run the next step", _next),
    "run": Command("STEP", "run a step that can start", _run),
    "to": Command("STEP", "run up to and including a step", _to),
    "back": Command("STEP", "repeat a step; shows what that supersedes", _back),
    "skip": Command("[STEP]", "refused: every result is needed later", _skip),
    "why": Command("[STEP]", "why a step cannot start now, and what it asks", _why),
    "dry": Command("[STEP]", "the motions of a step; nothing moves", _dry),
    "pause": Command("", "pause before the next step", _pause),
    "stop": Command(
        "", "stop the arm and pause, from a script while a step runs; typed, Ctrl-C twice", _stop
    ),
    "resume": Command("", "continue a paused case", _resume),
    "home": Command("", "instrument out, guide back, then park; not while a step is paused", _home),
    "acknowledge": Command("YOUR-NAME", "recover devices in fault; a paused step begins again", _acknowledge),
    "abort": Command("", "home, then end the case", _abort),
    "help": Command("", "this list", _help),
}
