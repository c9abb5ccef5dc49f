"""The language of fault scripts: one fault per line, the same on the command line, in tests and live.

    at 12.5 s: tracker occlude marker 3 for 2 s
    when step == relocalization: robot drop 5 % for 1 s
    at cycle 500: robot drop 100 % for 0.012 s
    now: tracker occlude tool robot_frame for 1 s

Times are theatre time. Cycles are telegrams that the robot's controller has sent since it was started. A
fault of `when` begins with the step; `relocalization:T1` is the step of one trajectory, `relocalization` that
of each. `now` is for the control port; in a script it is the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from difflib import SequenceMatcher, get_close_matches
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ronna_hw.bounded_input import InputRefused, read_bounded
from sim.errors import BadFaultScript
from sim.theatre.faults.camera import CAMERA_FAULTS
from sim.theatre.faults.fault import Fault
from sim.theatre.faults.kinds import TERMINALS, FaultKind, either
from sim.theatre.faults.robot import ROBOT_FAULTS
from sim.theatre.faults.room import ROOM_FAULTS
from sim.theatre.faults.tracker import TRACKER_FAULTS
from sim.theatre.scene.model import Scene

if TYPE_CHECKING:
    from lark import Lark
    from lark.exceptions import UnexpectedInput

FAULT_KINDS: tuple[FaultKind, ...] = (*TRACKER_FAULTS, *ROBOT_FAULTS, *CAMERA_FAULTS, *ROOM_FAULTS)
NOW = "now"
CYCLES_OF = "robot"  # the device whose cycles a script can name
TRIGGERS = ("at", "when", NOW)
LONGEST_SCRIPT = 100_000  # characters: some two thousand faults
MOST_MISTAKES = 20  # that are told at once; each costs a search for what was meant
LONGEST_COMPARED = 200  # characters of a line in that search
MOST_LISTED = 6  # of what may stand at a place; beyond this the closest ones are listed
END, END_OF_TEXT = "$END", "<END-OF-FILE>"  # the parser's tokens
READABLE = {
    "INT": "a whole number",
    "NUMBER": "a number",
    "SIGNED": "a number",
    "NAME": "a name",
    "STEP": "the name of a step",
}

GRAMMAR = r"""
start: statement?
statement: trigger ":" fault duration?
?trigger: "at" NUMBER "s"            -> at
        | "at" "cycle" INT           -> at_cycle
        | "when" "step" "==" STEP    -> when
        | "now"                      -> now
duration: "for" NUMBER "s"
?fault: {faults}
STEP: /[A-Za-z_][A-Za-z0-9_]*(:[A-Za-z0-9][A-Za-z0-9_.-]*)?/
NAME: /[A-Za-z0-9_][A-Za-z0-9_.-]*/
SIGNED: /[+-]?[0-9]+([.][0-9]+)?/
COMMENT: /#[^\n]*/
%import common.NUMBER
%import common.INT
%import common.WS_INLINE
%ignore WS_INLINE
%ignore COMMENT
"""


def parse_faults(text: str) -> tuple[Fault, ...]:
    """Parse a script; raises SIM-003 with every line that is not a fault."""
    from lark.exceptions import UnexpectedInput

    if len(text) > LONGEST_SCRIPT:
        raise BadFaultScript("the fault script is too long", limit=f"{LONGEST_SCRIPT} characters")
    faults: list[Fault] = []
    mistakes: list[Mistake] = []
    for number, line in enumerate(text.split("\n"), 1):
        try:
            tree = _grammar().parse(line.rstrip())
        except UnexpectedInput as error:
            mistakes.append(_unexpected(error, line.rstrip(), number))
            if len(mistakes) == MOST_MISTAKES:
                break
            continue
        for statement in tree.children:
            fault, has_duration = _fault(statement, number)
            faults.append(fault)
            if has_duration and fault.kind.momentary:
                what = f"line {number}: expected no duration, because the fault happens only once"
                mistakes.append(Mistake(what, fault.kind.example))
    _refuse(mistakes)
    return tuple(faults)


def begin_now(line: str, now_s: float) -> str:
    """The line with `now` replaced by the present theatre time."""
    trigger, colon, rest = line.partition(":")
    return f"at {now_s:.6f} s{colon}{rest}" if trigger.strip() == NOW else line


def read_faults(path: Path, scene: Scene) -> str:
    """Text of a script that is right for `scene`; raises SIM-003."""
    try:
        text = read_bounded(path, LONGEST_SCRIPT).decode()
    except InputRefused as error:
        raise BadFaultScript(error.summary) from error
    except OSError as error:
        raise BadFaultScript(f"cannot read the fault script {path.name}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadFaultScript(f"{path.name} is not text in UTF-8: {error.reason}") from error
    check_faults(parse_faults(text), scene)
    return text


def check_faults(faults: Iterable[Fault], scene: Scene) -> None:
    """Raise SIM-003 with every fault that names a marker or tool that the scene does not have."""
    _refuse(
        [
            Mistake(f"line {fault.line}: {mistake}", fault.kind.example)
            for fault in faults
            for mistake in _mistakes(fault, scene)
        ]
    )


def _mistakes(fault: Fault, scene: Scene) -> Iterator[str]:
    if fault.cycle is not None and fault.kind.device != CYCLES_OF:
        yield f"expected a time: only the {CYCLES_OF} counts cycles, not the {fault.kind.device}"
    yield from fault.kind.check(fault.arguments, scene)


class Mistake(NamedTuple):
    """What is wrong with a line, and a line that is right."""

    what: str
    example: str


def _refuse(mistakes: list[Mistake]) -> None:
    if mistakes:
        what = "; ".join(mistake.what for mistake in mistakes)
        advice = f"Write for example: {mistakes[0].example}. `ronna-sim fault` lists all faults."
        raise BadFaultScript(what, action=advice)


def _unexpected(error: UnexpectedInput, line: str, number: int) -> Mistake:
    """The mistake at which the parser stopped."""
    from lark.exceptions import UnexpectedCharacters, UnexpectedToken

    names: set[str] = set()
    ended = False
    if isinstance(error, UnexpectedCharacters):
        names = set(error.allowed or ())
    elif isinstance(error, UnexpectedToken):
        names, ended = set(error.accepts or error.expected), error.token.type == END
    column = len(line) + 1 if ended else error.column
    got = "the end of the line" if ended else repr(line[column - 1 :].split()[0])
    words = sorted({_readable(name) for name in names - {END, END_OF_TEXT, "COMMENT", "WS_INLINE"}})
    words = words or ["the end of the line"]
    if len(words) > MOST_LISTED:
        words = get_close_matches(got, words) or [*words[:MOST_LISTED], "another fault"]
    nearest = max(
        FAULT_KINDS,
        key=lambda kind: SequenceMatcher(None, kind.usage, line.partition(":")[2][:LONGEST_COMPARED]).ratio(),
    )
    return Mistake(f"line {number}, column {column}: expected {either(words)}, got {got}", nearest.example)


def _readable(terminal: str) -> str:
    return READABLE.get(terminal) or repr(_grammar().get_terminal(terminal).pattern.value)


@cache
def _grammar() -> Lark:
    from lark import Lark

    alternatives = "\n      | ".join(
        " ".join([f'"{kind.device}"', *(_symbol(word) for word in kind.phrase.split())]) + f" -> {kind.name}"
        for kind in FAULT_KINDS
    )
    return Lark(GRAMMAR.replace("{faults}", alternatives), parser="lalr")


def _symbol(word: str) -> str:
    return word if word in TERMINALS else f'"{word}"'


def _fault(statement: Any, line: int) -> tuple[Fault, bool]:
    """The fault, and whether the line gave a duration."""
    trigger, phrase, *ending = statement.children
    kind = next(kind for kind in FAULT_KINDS if kind.name == phrase.data)
    duration_s = float(ending[0].children[0]) if ending else (0.0 if kind.momentary else math.inf)
    begin = str(trigger.children[0]) if trigger.children else "0"
    fault = Fault(
        kind=kind,
        arguments=tuple(str(argument) for argument in phrase.children),
        duration_s=duration_s,
        at_s=float(begin) if trigger.data in ("at", NOW) else None,
        step=begin if trigger.data == "when" else None,
        cycle=int(begin) if trigger.data == "at_cycle" else None,
        line=line,
    )
    return fault, bool(ending)
