"""Where we are: the state chart of the procedure.

Transitions are instant and pure; the work of a step happens while the machine rests in the step's state,
never in a callback. A transition is refused while preconditions are unmet.
"""

from __future__ import annotations

from typing import Any, cast

from transitions.extensions import HierarchicalMachine
from transitions.extensions.nesting import NestedState

from procedures.engine.order import ENDS, IDLE, PHASES, PREDECESSORS

SEPARATOR = "."  # between phase and step; the library's own underscore occurs in names of steps


def state_of(step: str) -> str:
    """Name of a step's state in the machine, phase first."""
    for phase, steps in PHASES.items():
        if step in steps:
            return f"{phase}{SEPARATOR}{step}"
    return step


class _StepState(NestedState):
    separator = SEPARATOR


class _Machine(HierarchicalMachine):
    state_cls = _StepState


class Whereabouts:
    """The model of the machine: only the present state."""

    state: str


class ProcedureMachine:
    """Begin a step, finish, fail or abort; nothing else changes the state."""

    def __init__(self) -> None:
        self.model = Whereabouts()
        _Machine(
            self.model,
            states=_states(),
            transitions=_transitions(),
            initial=IDLE,
            auto_transitions=False,
            send_event=True,
        )

    @property
    def state(self) -> str:
        """Present state, phase and step."""
        return self.model.state

    def may_follow(self, step: str) -> bool:
        """True when the order of steps allows `step` now."""
        return self.state in {state_of(source) for source in PREDECESSORS[step]}

    def begin(self, step: str, unmet: tuple[str, ...]) -> bool:
        """Enter a step's state; returns False, and stays, while preconditions are unmet."""
        return self._trigger(f"begin_{step}", unmet=unmet)

    def finish(self) -> None:
        """The last retreat is done."""
        self._trigger("finish")

    def fail(self) -> None:
        """A step ended with an error."""
        self._trigger("fail")

    def abort(self) -> None:
        """The operator ended the procedure."""
        self._trigger("abort")

    def _trigger(self, event: str, **details: Any) -> bool:
        # `transitions` makes its triggers at run time; this is the one untyped call.
        return bool(cast("Any", self.model).trigger(event, **details))


def _all_met(event: Any) -> bool:
    return not event.kwargs.get("unmet")


def _states() -> list[Any]:
    nested = [{"name": phase, "children": list(steps)} for phase, steps in PHASES.items()]
    return [IDLE, *nested, *ENDS]


def _transitions() -> list[dict[str, Any]]:
    steps = [step for group in PHASES.values() for step in group]
    rows: list[dict[str, Any]] = [
        {
            "trigger": f"begin_{step}",
            "source": [state_of(source) for source in PREDECESSORS[step]],
            "dest": state_of(step),
            "conditions": _all_met,
        }
        for step in steps
    ]
    running = [IDLE, *(state_of(step) for step in steps)]
    rows.append({"trigger": "finish", "source": state_of("retreat"), "dest": "finished"})
    rows.append({"trigger": "fail", "source": running, "dest": "fault"})
    rows.append({"trigger": "abort", "source": running, "dest": "aborted"})
    return rows


def mermaid() -> str:
    """The state chart as mermaid text, generated from the machine's own tables."""
    lines = ["stateDiagram-v2", f"  [*] --> {IDLE}"]
    for phase, steps in PHASES.items():
        lines.append(f"  state {phase} {{")
        lines.extend(f"    {step}" for step in steps)
        lines.append("  }")
    for step, sources in PREDECESSORS.items():
        lines.extend(f"  {source} --> {step}" for source in sources)
    lines.append("  retreat --> finished")
    for end in ("fault", "aborted"):
        lines.extend(f"  {phase} --> {end}" for phase in PHASES)
    lines.extend(f"  {end} --> [*]" for end in ENDS)
    return "\n".join(lines) + "\n"
