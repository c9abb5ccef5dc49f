"""Where we are: the state chart of the procedure, made from its steps.

Transitions are instant and pure; the work of a step happens while the machine rests in the step's state,
never in a callback. Whether a step may begin is the engine's to decide, before it asks for the transition.
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


class _Triggered(Protocol):
    """What `transitions` adds to its model at run time, where no checker can see it."""

    def trigger(self, event: str) -> bool: ...


class ProcedureMachine:
    """Begin a step, finish, fail or abort; nothing else changes the state."""

    state: str  # phase and step

    def __init__(self, order: CaseOrder) -> None:
        running = [IDLE, *map(state_of, order.steps)]
        last = order.spec(order.sequence[-1])
        nested = [
            {"name": str(phase), "children": [step.name for step in order.steps if step.phase is phase]}
            for phase in Phase
        ]
        rows = [_row(f"begin_{step.name}", running, state_of(step)) for step in order.steps]
        rows += [_row(f"end_{end}", running, end) for end in (FAULT, ABORTED)]
        rows.append(_row(f"end_{FINISHED}", [state_of(last)], FINISHED))
        _Machine(
            self,
            states=[IDLE, *(state for state in nested if state["children"]), *ENDS],
            transitions=rows,
            initial=IDLE,
            auto_transitions=False,
        )

    @property
    def ended(self) -> bool:
        """Whether no step may begin any more."""
        return self.state in ENDS

    def begin(self, step: str) -> None:
        """Enter a step's state."""
        self._go(f"begin_{step}")

    def finish(self) -> None:
        """The last step is done and every result stands."""
        self._go(f"end_{FINISHED}")

    def fail(self) -> None:
        """A step ended with an error."""
        self._go(f"end_{FAULT}")

    def abort(self) -> None:
        """The operator ended the procedure."""
        self._go(f"end_{ABORTED}")

    def _go(self, event: str) -> None:
        cast("_Triggered", self).trigger(event)


def _row(trigger: str, source: list[str], dest: str) -> dict[str, object]:
    return {"trigger": trigger, "source": source, "dest": dest}


def state_of(step: StepSpec[StepResult]) -> str:
    """Name of a step's state in the machine, phase first."""
    return f"{step.phase}{SEPARATOR}{step.name}"


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
