"""Has the room's hands do something, and writes down what they read off."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from procedures.journal.journal import Entry, Journal
from procedures.operator.question import NotConfirmed, Question, Task, Topic
from ronna_hw.wire.room_tasks import OUT

if TYPE_CHECKING:
    from procedures.engine.context import CaseSetting

IS_OUT, INSIDE = "out", "inside"
# In place of a trajectory: where the mandrel is while the guide is checked or its tip calibrated.
IN_GAUGE, IN_DIVOT = "the gauge", "the divot"


def have_done(setting: CaseSetting, journal: Journal, task: Task) -> tuple[float, ...]:
    """What was read off; raises PRO-002 when nobody reads it, or no numbers."""
    began_s = setting.clock.now_s()
    readings = setting.room.work(task)
    if not all(map(math.isfinite, readings)):  # no limit holds against what is no number
        raise NotConfirmed(
            f"the readings are not finite numbers: {task.subject}",
            expected=", ".join(task.reads),
            got=str(readings),
        )
    journal.write(
        Entry.WORK,
        setting.clock.now_s(),
        task=task.name,
        subject=task.subject,
        trajectory=task.trajectory,
        readings=list(readings),
        began_s=began_s,
    )
    if len(readings) != len(task.reads):
        given = f"{len(readings)} of {len(task.reads)}" if readings else "no"
        raise NotConfirmed(f"{given} readings were given: {task.subject}", expected=", ".join(task.reads))
    return readings


def have_instrument_out(setting: CaseSetting, journal: Journal, ask: Callable[[Question], str]) -> None:
    """Have an instrument taken out, if one may be in the guide; raises PRO-002 unless it is said."""
    instrument = setting.workcell.instrument
    if (place := instrument.inside) is None:
        return
    trajectory = None if place in (IN_GAUGE, IN_DIVOT) else place
    have_done(setting, journal, Task(OUT, taking_out(place), trajectory))
    done = f"the {_what(place)} is out of {place} and out of the guide"
    if place == IN_DIVOT:
        done = f"{place} is lowered, and hands are clear of it and of the guide"
    question = Question(
        Topic.INSTRUMENT_OUT,
        done,
        "nothing moves while it is inside; afterwards the arm may move: stand clear before you answer",
        (IS_OUT, INSIDE),
        trajectory,
        timeout_s=None,
    )
    if ask(question) != IS_OUT:
        raise NotConfirmed(
            f"an instrument is still in {place}: nothing moves",
            action=f"By hand, {taking_out(place)}; then repeat the step or send the arm home.",
        )
    instrument.is_out()


def taking_out(place: str) -> str:
    """What hands do before the arm may leave a place."""
    if place == IN_DIVOT:
        return f"lower {place} from the guide"
    return f"remove the {_what(place)} from {place} and from the guide"


def _what(place: str) -> str:
    return "mandrel" if place == IN_GAUGE else "instrument"
