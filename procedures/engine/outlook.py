"""What a case consists of and what it waits for, as events for displays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from procedures.engine.events import Order, OrderedStep, Waiting

if TYPE_CHECKING:
    from procedures.engine.engine import Engine


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
    key = engine.upcoming
    unmet = () if key is None else engine.why_refused(key)
    engine.events.publish(Waiting(upcoming=None if key is None else str(key), unmet=unmet))
