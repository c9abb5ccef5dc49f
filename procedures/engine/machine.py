"""The procedure's state chart, derived from its steps.

Transitions are instant and pure; a step's work happens while the machine rests in its state, never in a
callback. The engine decides whether a step may begin before it asks for the transition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby, pairwise

from transitions.extensions import HierarchicalMachine
from transitions.extensions.nesting import NestedState

from procedures.engine.order import CaseOrder, Phase, Scope, Steps, StepSpec, order_of
from procedures.engine.states import ABORTED, BETWEEN, ENDS, FINISHED, HELD, IDLE, RECOVERY, RESTS
from procedures.journal.results import StepResult

SEPARATOR = "."  # between phase and step; the library's own underscore occurs in names of steps


class _StepState(NestedState):
    separator = SEPARATOR


class _Machine(HierarchicalMachine):
    state_cls = _StepState


class ProcedureMachine:
    """State machine of a procedure. The state changes only through its methods."""

    state: str  # phase and step, or what is between steps
    trigger: Callable[[str], bool]  # added by `transitions`, as `state` is

    def __init__(self, order: CaseOrder, *, recovering: bool = False) -> None:
        nested = [
            {"name": phase, "children": list(inside.values())}
            for phase, inside in _phases(order.steps).items()
        ]
        _Machine(
            self,
            states=[*BETWEEN, *nested, *ENDS],
            transitions=[list(one) for one in _transitions(order)],
            initial=RECOVERY if recovering else IDLE,
            auto_transitions=False,
        )

    @property
    def ended(self) -> bool:
        return self.state in ENDS

    def begin(self, step: str) -> None:
        """Enter a step's state."""
        self.trigger(f"begin_{step}")

    def accept(self) -> None:
        """Leave recovery: the operator accepted the findings after a restart."""
        self.trigger("case_accept")

    def hold(self) -> None:
        """Hold the case after a step failed or was abandoned."""
        self.trigger("case_hold")

    @contextmanager
    def resting(self, state: str) -> Iterator[None]:
        """Pause or suspend the case during the block, then always return to the previous state.

        The way home may also rest before a restart is accepted and after the end of the case. The chart does
        not change then: it says whether steps may begin.
        """
        before = self.state
        if before == RECOVERY or self.ended:
            yield
            return
        self.trigger(f"rest_{state}")
        try:
            yield
        finally:
            self.trigger(f"back_to_{before}")

    def finish(self) -> None:
        """End the case after its last step, with every result valid."""
        self.trigger("case_finish")

    def abort(self) -> None:
        """End the case because the operator aborted it."""
        self.trigger("case_abort")


def _transitions(order: CaseOrder) -> Iterator[tuple[str, Sequence[str], str]]:
    """Yield trigger, sources and destination of each transition."""
    working = [IDLE, HELD, *map(state_of, order.steps)]
    for step in order.steps:
        yield f"begin_{step.name}", working, state_of(step)
    for rest in RESTS:
        yield f"rest_{rest}", working, rest
    for state in working:
        yield f"back_to_{state}", RESTS, state
    yield "case_accept", [RECOVERY], HELD
    yield "case_hold", working, HELD
    yield "case_finish", [HELD, state_of(order.spec(order.sequence[-1]))], FINISHED
    yield "case_abort", [RECOVERY, *working], ABORTED


def state_of(step: StepSpec[StepResult]) -> str:
    """Return the name of a step's state, phase first."""
    return f"{step.phase}{SEPARATOR}{step.name}"


def state_chart_mermaid(steps: Steps) -> str:
    """Return the state chart as Mermaid text: the normal course of a case and all transitions.

    An arrow from or to a phase is one from or to each of its steps.
    """
    lines = ["stateDiagram-v2", f"  [*] --> {IDLE}", f"  [*] --> {RECOVERY} : resume"]
    for phase, inside in _phases(steps).items():
        lines.extend([f"  state {phase} {{", *(f"    {name}" for name in inside.values()), "  }"])
    names = [IDLE, *(step.name for step in steps)]
    lines.extend(f"  {one} --> {other}" for one, other in pairwise(names))
    lines.extend(f"  {last} --> {first} : next trajectory" for first, last in _blocks(steps))
    lines.extend(_arrows(order_of(steps, ("T1",))))
    lines.extend(f"  {end} --> [*]" for end in ENDS)
    lines.extend(f"  note right of {state} : {meaning}" for state, meaning in BETWEEN.items())
    return "\n".join(lines) + "\n"


def _arrows(order: CaseOrder) -> Iterator[str]:
    """Yield the transitions as arrows, joining many-to-many transitions at a junction."""
    ways: dict[tuple[str, ...], list[str]] = {}
    for _, sources, destination in _transitions(order):
        ways.setdefault(tuple(sources), []).append(destination)
    for number, (sources, destinations) in enumerate(ways.items(), start=1):
        before, after = _fold_phases(sources, order.steps), _fold_phases(destinations, order.steps)
        if min(len(before), len(after)) > 1:
            junction = f"junction{number}"
            yield f"  state {junction} <<choice>>"
            yield from (f"  {one} --> {junction}" for one in before)
            before = [junction]
        yield from (f"  {one} --> {other}" for one in before for other in after)


def _fold_phases(states: Sequence[str], steps: Steps) -> list[str]:
    """Return state names for the chart, replacing complete sets of a phase's steps by the phase."""
    names = list(states)
    for phase, inside in _phases(steps).items():
        is_whole = inside.keys() <= set(states)
        names = [phase if is_whole and one in inside else inside.get(one, one) for one in names]
    return list(dict.fromkeys(names))


def _phases(steps: Steps) -> dict[str, dict[str, str]]:
    """Map each non-empty phase to its states and their step names."""
    inside = {str(phase): {state_of(one): one.name for one in steps if one.phase is phase} for phase in Phase}
    return {phase: names for phase, names in inside.items() if names}


def _blocks(steps: Steps) -> list[tuple[str, str]]:
    """Return the first and last step of each block repeated per trajectory."""
    blocks = []
    for scope, block in groupby(steps, key=lambda step: step.scope):
        if scope is not Scope.CASE:
            names = [step.name for step in block]
            blocks.append((names[0], names[-1]))
    return blocks
