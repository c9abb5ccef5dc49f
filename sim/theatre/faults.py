"""Faults by script, one per line, the same on the command line, in tests and live:

    at 12.5 s: tracker occlude marker 3 for 2 s
    when step == relocalization: robot drop 5 % for 1 s

Times are theatre time. A fault of `when` begins with the step; `relocalization:T1` is the step of one
trajectory, `relocalization` that of each. Each device asks its own board.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.errors import BadFaultScript
from sim.theatre.scene import Scene
from sim.theatre.world import World

if TYPE_CHECKING:
    from lark import Lark

GRAMMAR = r"""
start: statement?
statement: trigger ":" fault "for" NUMBER "s"
?trigger: "at" NUMBER "s"            -> at
        | "when" "step" "==" NAME    -> when
?fault: "tracker" "occlude" "marker" INT  -> occlude_marker
      | "tracker" "occlude" "tool" NAME   -> occlude_tool
      | "robot" "drop" NUMBER "%"         -> drop
      | "camera" "drop" NUMBER "%"        -> camera_drop
NAME: /[A-Za-z_][A-Za-z0-9_.-]*(:[A-Za-z0-9][A-Za-z0-9_.-]*)?/
COMMENT: /#[^\n]*/
%import common.NUMBER
%import common.INT
%import common.WS_INLINE
%ignore WS_INLINE
%ignore COMMENT
"""

DEVICE_OF = {"occlude_marker": "tracker", "occlude_tool": "tracker", "drop": "robot", "camera_drop": "camera"}
DROPS = ("drop", "camera_drop")
WHOLE_PERCENT = 100.0
# The steps of a procedure, as the operator names them at the control port.
STEPS = (
    "ct_import",
    "fiducial_localization",
    "plan_check",
    "set_up",
    "global_localization",
    "correspondence",
    "path_check",
    "relocalization",
    "registration",
    "tool_change",
    "positioning",
    "at_target",
    "retreat",
)


@dataclass(frozen=True)
class Fault:
    """One line of a script: either `at_s` or `step` says when it begins."""

    device: str
    kind: str
    argument: str
    duration_s: float
    at_s: float | None = None
    step: str | None = None
    line: int = 1  # of the script

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
    """Parse a script; raises SIM-003 with every line that is not a fault."""
    from lark.exceptions import UnexpectedInput

    faults: list[Fault] = []
    mistakes: list[str] = []
    for number, line in enumerate(text.split("\n"), 1):
        try:
            tree = _grammar().parse(line.rstrip())
        except UnexpectedInput as error:
            place = f", column {error.column}" if error.column > 0 else ""
            mistakes.append(f"line {number}{place}: {line.strip()!r} is not a fault")
            continue
        for statement in tree.children:
            fault = _fault(statement, number)
            if fault.kind in DROPS and float(fault.argument) > WHOLE_PERCENT:
                mistakes.append(f"line {number}: {fault.argument} % is more than everything")
            faults.append(fault)
    _refuse(mistakes)
    return tuple(faults)


def read_faults(path: Path, scene: Scene) -> str:
    """Text of a script that is right for `scene`; raises SIM-003."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise BadFaultScript(f"cannot read the fault script {path.name}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadFaultScript(f"{path.name} is not text in UTF-8: {error.reason}") from error
    check_faults(parse_faults(text), scene)
    return text


def check_faults(faults: Iterable[Fault], scene: Scene) -> None:
    """Raise SIM-003 with every fault that names a step, target, marker or tool that is not there."""
    _refuse([f"line {fault.line}: {mistake}" for fault in faults for mistake in _mistakes(fault, scene)])


def _mistakes(fault: Fault, scene: Scene) -> Iterator[str]:
    step, _, target = (fault.step or "").partition(":")
    if step and step not in STEPS:
        yield f"there is no step {step!r}, only {', '.join(STEPS)}"
    targets = [item.identifier for item in scene.head.targets]
    if target and target not in targets:
        yield f"there is no target {target!r}, only {', '.join(targets)}"
    markers = [str(fiducial.number) for fiducial in scene.head.fiducials]
    if fault.kind == "occlude_marker" and fault.argument not in markers:
        yield f"there is no marker {fault.argument}, only {', '.join(markers)}"
    tools = [tool.name for tool in scene.tracker.tools]
    known = {*tools, *(tool.part_number for tool in scene.tracker.tools)}
    # Where there are places for other tools, a client may load definitions that the scene does not know.
    if fault.kind == "occlude_tool" and not scene.tracker.places and fault.argument not in known:
        yield f"there is no tool {fault.argument!r}, only {', '.join(tools)}"


def _refuse(mistakes: list[str]) -> None:
    if mistakes:
        raise BadFaultScript("; ".join(mistakes))


def _fault(statement: Any, line: int) -> Fault:
    trigger, fault, duration = statement.children
    begin = str(trigger.children[0])
    return Fault(
        device=DEVICE_OF[fault.data],
        kind=str(fault.data),
        argument=str(fault.children[0]),
        duration_s=float(duration),
        at_s=float(begin) if trigger.data == "at" else None,
        step=begin if trigger.data == "when" else None,
        line=line,
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
