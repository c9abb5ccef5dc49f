"""Faults by script, one per line, the same on the command line, in tests and live:

    at 12.5 s: tracker occlude marker 3 for 2 s
    when step == relocalization: robot drop 5 % for 1 s

Times are theatre time. A fault of `when` begins with the step; `relocalization:T1` is the step of one
trajectory, `relocalization` that of each. Each device asks its own board.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from sim.errors import BadFaultScript
from sim.theatre.world import World

if TYPE_CHECKING:
    from lark import Lark

GRAMMAR = r"""
start: (statement? _NEWLINE)* statement?
statement: trigger ":" fault "for" NUMBER "s"
?trigger: "at" NUMBER "s"            -> at
        | "when" "step" "==" NAME    -> when
?fault: "tracker" "occlude" "marker" INT  -> occlude_marker
      | "tracker" "occlude" "tool" NAME   -> occlude_tool
      | "robot" "drop" NUMBER "%"         -> drop
      | "camera" "drop" NUMBER "%"        -> camera_drop
_NEWLINE: /\r?\n/
NAME: /[A-Za-z_][A-Za-z0-9_.-]*(:[A-Za-z0-9][A-Za-z0-9_.-]*)?/
COMMENT: /#[^\n]*/
%import common.NUMBER
%import common.INT
%import common.WS_INLINE
%ignore WS_INLINE
%ignore COMMENT
"""

DEVICE_OF = {"occlude_marker": "tracker", "occlude_tool": "tracker", "drop": "robot", "camera_drop": "camera"}


@dataclass(frozen=True)
class Fault:
    """One line of a script: either `at_s` or `step` says when it begins."""

    device: str
    kind: str
    argument: str
    duration_s: float
    at_s: float | None = None
    step: str | None = None

    def active(self, now_s: float, step: str, step_started_s: float) -> bool:
        """True while the fault acts."""
        if self.at_s is not None:
            begin = self.at_s
        elif self.step in (step, step.partition(":")[0]):
            begin = step_started_s
        else:
            return False
        return begin <= now_s < begin + self.duration_s


@cache
def _grammar() -> Lark:
    from lark import Lark

    return Lark(GRAMMAR, parser="lalr")


def parse_faults(text: str) -> tuple[Fault, ...]:
    """Parse a script; raises SIM-003 with the line and what was expected."""
    from lark.exceptions import UnexpectedInput

    try:
        tree = _grammar().parse(text + "\n")
    except UnexpectedInput as error:
        line = text.splitlines()[error.line - 1] if 0 < error.line <= len(text.splitlines()) else text
        raise BadFaultScript(
            f"line {error.line}, column {error.column}: {line.strip()!r} is not a fault"
        ) from error
    return tuple(_fault(statement) for statement in tree.children)


def _fault(statement: Any) -> Fault:
    trigger, fault, duration = statement.children
    begin = str(trigger.children[0])
    return Fault(
        device=DEVICE_OF[fault.data],
        kind=str(fault.data),
        argument=str(fault.children[0]),
        duration_s=float(duration),
        at_s=float(begin) if trigger.data == "at" else None,
        step=begin if trigger.data == "when" else None,
    )


class FaultBoard:
    """The faults of one device, as the world's script has them now. Cheap to ask while there are none."""

    def __init__(self, world: World, device: str) -> None:
        self._world = world
        self._device = device
        self._version = -1
        self._faults: tuple[Fault, ...] = ()

    def active(self, kind: str) -> tuple[str, ...]:
        """Arguments of all faults of that kind that act now."""
        version, text = self._world.fault_script()
        if version != self._version:
            faults = parse_faults(text) if text.strip() else ()
            self._faults = tuple(fault for fault in faults if fault.device == self._device)
            self._version = version
        if not self._faults:
            return ()
        step, started_ns = self._world.step()
        now_s = self._world.clock.now_s()
        return tuple(
            fault.argument
            for fault in self._faults
            if fault.kind == kind and fault.active(now_s, step, started_ns / 1e9)
        )
