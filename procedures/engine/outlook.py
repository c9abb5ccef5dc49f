"""What a case consists of and what it waits for, as events for displays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from procedures.engine.device_faults import ARM
from procedures.engine.events import Order, OrderedStep, Waiting

if TYPE_CHECKING:
    from procedures.engine.engine import Engine


HOME = "home"  # comes when every step is done and the arm, or an instrument, is still out


def publish_order(engine: Engine) -> None:
    """Publish the steps of the case in their order."""
    specs = [(key, engine.order.spec(key)) for key in engine.order.sequence]
    engine.events.publish(
        Order(
            steps=tuple(
                OrderedStep(
                    step=str(key),
                    title=spec.title,
                    phase=str(spec.phase),
                    moves=spec.moves,
                    record=engine.case.record_of(key),
                )
                for key, spec in specs
            )
        )
    )


def publish_waiting(engine: Engine) -> None:
    """Publish what comes next, and why it may not begin."""
    key, name = engine.upcoming, comes_next(engine)
    if key is not None:
        unmet = engine.why_refused(key)
    else:
        fault = engine.faults.described.get(ARM) if name == HOME else None
        unmet = () if fault is None else (fault,)
    engine.events.publish(Waiting(upcoming=name, unmet=unmet))


def comes_next(engine: Engine) -> str | None:
    """The upcoming step, or the way home where only that remains; None when the case is over."""
    if (key := engine.upcoming) is not None:
        return str(key)
    return HOME if engine.course.over and not engine.over else None
