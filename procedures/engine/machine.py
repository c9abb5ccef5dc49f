"""Where we are: the state chart of the procedure, made from its steps.

Transitions are instant and pure; the work of a step happens while the machine rests in the step's state,
never in a callback. A transition is refused while preconditions are unmet.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Protocol, cast

from transitions.extensions import HierarchicalMachine
from transitions.extensions.nesting import NestedState

from procedures.engine.order import CaseOrder, Steps
from procedures.engine.result import StepResult
from procedures.engine.step import Phase, Scope, StepSpec

SEPARATOR = "."  # between phase and step; the library's own underscore occurs in names of steps
IDLE = "idle"
FINISHED, FAULT, ABORTED = "finished", "fault", "aborted"
ENDS = (FINISHED, FAULT, ABORTED)


class _StepState(NestedState):
    separator = SEPARATOR


class _Machine(HierarchicalMachine):
    state_cls = _StepState


class _Event(Protocol):
    """What the library hands to a condition."""

    kwargs: dict[str, tuple[str, ...]]


class _Triggered(Protocol):
    """What the library adds to the model at run time."""

    def trigger(self, event: str, **details: tuple[str, ...]) -> bool: ...


class Whereabouts:
    """The model of the machine: only the present state."""

    state: str


class ProcedureMachine:
    """Begin a step, finish, fail or abort; nothing else changes the state."""

    def __init__(self, order: CaseOrder) -> None:
        self.model = Whereabouts()
        steps = order.steps
        running = [IDLE, *map(state_of, steps)]
        last = order.spec(order.sequence[-1])
        rows: list[dict[str, object]] = [
            {
                "trigger": f"begin_{step.name}",
                "source": running,
                "dest": state_of(step),
                "conditions": _nothing_unmet,
            }
            for step in steps
        ]
        rows.append({"trigger": "finish", "source": state_of(last), "dest": FINISHED})
        rows.append({"trigger": "fail", "source": running, "dest": FAULT})
        rows.append({"trigger": "abort", "source": running, "dest": ABORTED})
        nested = [
            {"name": str(phase), "children": [step.name for step in steps if step.phase is phase]}
            for phase in Phase
        ]
        _Machine(
            self.model,
            states=[IDLE, *(state for state in nested if state["children"]), *ENDS],
            transitions=rows,
            initial=IDLE,
            auto_transitions=False,
            send_event=True,
        )

    @property
    def state(self) -> str:
        """Present state, phase and step."""
        return self.model.state

    @property
    def ended(self) -> bool:
        """Whether no step may begin any more."""
        return self.state in ENDS

    def begin(self, step: str, unmet: tuple[str, ...]) -> bool:
        """Enter a step's state; returns False, and stays, while preconditions are unmet."""
        return self._trigger(f"begin_{step}", unmet=unmet)

    def finish(self) -> None:
        """The last step is done and every result stands."""
        self._trigger("finish")

    def fail(self) -> None:
        """A step ended with an error."""
        self._trigger("fail")

    def abort(self) -> None:
        """The operator ended the procedure."""
        self._trigger("abort")

    def _trigger(self, event: str, **details: tuple[str, ...]) -> bool:
        # `transitions` makes its triggers at run time; this is the one call that no checker can see.
        return bool(cast("_Triggered", self.model).trigger(event, **details))


def state_of(step: StepSpec[StepResult]) -> str:
    """Name of a step's state in the machine, phase first."""
    return f"{step.phase}{SEPARATOR}{step.name}"


def _nothing_unmet(event: _Event) -> bool:
    return not event.kwargs.get("unmet")


def mermaid(steps: Steps) -> str:
    """The state chart as mermaid text: the way through a case, and what is done for each trajectory."""
    lines = ["stateDiagram-v2", f"  [*] --> {IDLE}"]
    phases = [phase for phase in Phase if any(step.phase is phase for step in steps)]
    for phase in phases:
        lines.append(f"  state {phase} {{")
        lines.extend(f"    {step.name}" for step in steps if step.phase is phase)
        lines.append("  }")
    names = [IDLE, *(step.name for step in steps), FINISHED]
    lines.extend(f"  {one} --> {other}" for one, other in pairwise(names))
    lines.extend(f"  {last} --> {first} : next trajectory" for first, last in _blocks(steps))
    for end in (FAULT, ABORTED):
        lines.extend(f"  {phase} --> {end}" for phase in phases)
    lines.extend(f"  {end} --> [*]" for end in ENDS)
    return "\n".join(lines) + "\n"


def _blocks(steps: Steps) -> list[tuple[str, str]]:
    """First and last step of what is done for each trajectory."""
    blocks = []
    for scope in (Scope.LOCALIZATION, Scope.TRAJECTORY):
        names = [step.name for step in steps if step.scope is scope]
        if names:
            blocks.append((names[0], names[-1]))
    return blocks
