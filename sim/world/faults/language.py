"""Fault script language: one fault per line, with the same syntax on the command line, in tests and live.

    at 12.5 s: tracker occlude marker 3 for 2 s
    when step == relocalization: robot drop 5 % for 1 s
    at cycle 500: robot drop 100 % for 0.012 s
    since step == relocalization:T2: room shift cart 0 2 0 mm
    since step == positioning:T1 after 1.5 s: room bent tip 0.5 0 0 mm
    now: tracker occlude tool robot_frame for 1 s
    at 3 s: assistant robot network cut for 1 s

Times are theatre time. Cycles are telegrams sent by the robot's controller since its start. A fault with
`when` acts while the step runs, one with `since` from its first start on; `relocalization:T1` is the
step of one trajectory, `relocalization` that of each. `now` is for the control port; in a script it
means the beginning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ronna_hw.bounded_input import InputRefused, read_bounded
from ronna_hw.near_names import find_near
from sim.errors import BadFaultScript
from sim.world.descriptions import DESCRIPTIONS, MAKES
from sim.world.faults.camera import CAMERA_FAULTS
from sim.world.faults.fault import LARGEST, TERMINALS, Fault, FaultKind, join_choices
from sim.world.faults.plain_lines import read_plain_line
from sim.world.faults.robot import ROBOT_FAULTS
from sim.world.faults.room import ROOM_FAULTS
from sim.world.faults.tracker import TRACKER_FAULTS, check_tool_is_there
from sim.world.faults.universal_robots import UR_FAULTS
from sim.world.options import OTHER_ARMS, ArmRole
from sim.world.scene.model import ArmTruth, Scene

if TYPE_CHECKING:
    from lark import Lark
    from lark.exceptions import UnexpectedInput

OTHER_UNITS = frozenset(
    ["um", "cm", "m", "km", "ms", "min", "h", "rad", "mrad", "kN"]
)  # in which a number may be meant
MOST_TRIED = 4  # similar lines, each of which is parsed
MOST_ADDED = 6  # words missing from a line: units, and two of three numbers
DIRECTION = ("x", "y", "z")  # of three numbers, as in `shift head 0 2 0 mm`
LEAST_ALIKE = 0.6  # similarity of line and suggestion; below, an example helps more
_NUMBERED = ("cart", "marker")  # whose number follows: it is none of a direction
_ARGUMENT = re.compile(r"[+-]?[0-9]+([.][0-9]+)?|[A-Za-z0-9_][A-Za-z0-9_.-]*")
_NUMBERS_BEFORE = re.compile(r"(?P<word>\S+)?\s+(?P<numbers>[+-]?[0-9.]+(\s+[+-]?[0-9.]+)*)\s*$")
_WORDS = re.compile(r"[A-Za-z_]+(\s+[A-Za-z_]+)*")
_TRIGGER = r"\s*(at|when|since|now)\b[^:]*(:[A-Za-z0-9_.-]+)?:"  # a step may name its trajectory
_BEGINNING = re.compile(rf"({_TRIGGER})?\s*(assistant\b\s*)?")

FAULT_KINDS: tuple[FaultKind, ...] = (
    *TRACKER_FAULTS,
    *ROBOT_FAULTS,
    *UR_FAULTS,
    *CAMERA_FAULTS,
    *ROOM_FAULTS,
)
NOW, SINCE = "now", "since"
OF_ASSISTANT = "of_assistant"  # rule of the grammar
CYCLES_OF = tuple(MAKES)  # devices whose cycles a script can name
TRIGGERS = ("at", "when", SINCE, NOW)
DEVICES = ("tracker", "robot", "camera", "room")  # of a theatre with KUKA arms

LONGEST_SCRIPT = 100_000  # characters: some two thousand faults
MOST_MISTAKES = 20  # reported at once
MOST_LISTED = 6  # words allowed at a position; of more, the closest ones
END, END_OF_TEXT = "$END", "<END-OF-FILE>"  # the parser's tokens
BEGINS_NOW = f"{NOW}: "  # prepended to a line typed without a beginning
EXAMPLE = "at 12.5 s: tracker occlude marker 2 for 2 s"
READABLE = {
    "INT": "a whole number",
    "NUMBER": "a number",
    "SIGNED": "a number",
    "NAME": "a name",
    "STEP": "the name of a step",
}

STEP = r"[A-Za-z_][A-Za-z0-9_]*(:[A-Za-z0-9][A-Za-z0-9_.-]*)?"
GRAMMAR = r"""
start: statement?
statement: trigger ":" fault duration?
         | trigger ":" "assistant" fault duration? -> of_assistant
?trigger: "at" NUMBER "s"            -> at
        | "at" "cycle" INT           -> at_cycle
        | "when" "step" "==" STEP    -> when
        | "since" "step" "==" STEP ("after" NUMBER "s")? -> since
        | "now"                      -> now
duration: "for" NUMBER "s"
?fault: {faults}
STEP: /{step}/
NAME: /[A-Za-z0-9_][A-Za-z0-9_.-]*/
SIGNED: /[+-]?[0-9]+([.][0-9]+)?/
COMMENT: /#[^\n]*/
%import common.NUMBER
%import common.INT
%import common.WS_INLINE
%ignore WS_INLINE
%ignore COMMENT
"""


def devices_of(scene: Scene) -> tuple[str, ...]:
    """Return the devices of a theatre, depending on its arms."""
    return ("tracker", *dict.fromkeys(map(_controller_of, scene.arms.values())), "camera", "room")


def _controller_of(arm: ArmTruth) -> str:
    return DESCRIPTIONS[arm.variant].make.in_faults


def parse_faults(text: str) -> tuple[Fault, ...]:
    """Parse a fault script; raises SIM-003 listing every invalid line, with a suggestion for the first.

    The grammar is built only for lines that `read_plain_line` leaves to it: building it takes 0.3 s of
    processor time, during which a device that parses its first fault would serve nobody.
    """
    if len(text) > LONGEST_SCRIPT:
        raise BadFaultScript("the fault script is too long", limit=f"{LONGEST_SCRIPT} characters")
    faults: list[Fault] = []
    mistakes: list[Mistake] = []
    for number, line in enumerate(text.split("\n"), 1):
        plain = read_plain_line(line, number, FAULT_KINDS)
        if plain is not None:
            faults.append(plain)
            continue
        tree = _parse_line(line.rstrip(), number, mistakes)
        if tree is None:
            if len(mistakes) == MOST_MISTAKES:
                break
            continue
        for statement in tree.children:
            fault, has_duration = _build_fault(statement, number)
            faults.append(fault)
            if has_duration and fault.kind.momentary:
                got = f"got 'for {fault.duration_s:g} s': this fault is momentary"
                what = f"line {number}: expected no duration, {got}"
                mistakes.append(Mistake(what, fault.kind.example))
    _refuse(mistakes)
    return tuple(faults)


def _parse_line(line: str, number: int, mistakes: list[Mistake]) -> Any:
    """Return the parser's tree of a line, or None and one more of the mistakes."""
    from lark.exceptions import UnexpectedInput

    try:
        return _build_grammar().parse(line)
    except UnexpectedInput as error:
        mistakes.append(_describe_unexpected(error, line, number, advises=not mistakes))
        return None


def parse_request(line: str) -> Fault:
    """Parse a single fault typed at the control port; raises SIM-003.

    Without a beginning it begins now.
    """
    if "\n" in line:
        raise BadFaultScript("expected one line", got=repr(line), action="Give one fault at a time.")
    faults = parse_faults(line if has_beginning(line) or not line.strip() else f"{BEGINS_NOW}{line}")
    if not faults:
        raise BadFaultScript(f"no fault in {line!r}", action=f"Write for example: {EXAMPLE}.")
    return faults[0]


def has_beginning(line: str) -> bool:
    """Return whether a line specifies when its fault begins."""
    return line.lstrip().split(":")[0].split(maxsplit=1)[:1] in [[trigger] for trigger in TRIGGERS]


def read_faults(path: Path, scene: Scene | None, devices: Sequence[str] | None = None) -> str:
    """Read a script and check it against the scene and present devices, by default all; raises SIM-003.

    Without a scene only the lines themselves are checked.
    """
    try:
        text = read_bounded(path, LONGEST_SCRIPT).decode()
    except InputRefused as error:
        raise BadFaultScript(f"{path}: {error.summary}") from error
    except OSError as error:
        raise BadFaultScript(f"cannot read the fault script {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadFaultScript(f"{path.name} is not UTF-8 text: {error.reason}") from error
    try:
        faults = parse_faults(text)
        if scene is not None:
            check_faults(faults, scene, devices)
    except BadFaultScript as error:
        what = f"{path.name}, {error.what}"
        raise BadFaultScript(what, limit=error.limit, action=error.advice) from error
    return text


def check_faults(
    faults: Iterable[Fault],
    scene: Scene,
    devices: Sequence[str] | None = None,
    loaded: Sequence[str] | None = None,
) -> None:
    """Raise SIM-003 listing every fault that refers to a missing device, marker or tool.

    `devices` are all of the theatre by default; `loaded` are the tools that a client has loaded into the
    tracker, if known.
    """
    devices = devices_of(scene) if devices is None else devices
    mistakes = []
    for fault in faults:
        found = list(_list_mistakes(fault, scene, devices))
        if not found and loaded is not None:
            found = list(check_tool_is_there(fault, scene, loaded))
        if found:
            shown = _most_alike(fault, _meant_devices(fault, scene, devices))
            is_of_arm = fault.role in scene.arms and shown.device in CYCLES_OF
            example = _example_of(shown, fault.role if is_of_arm else ArmRole.MASTER)
            mistakes += [Mistake(f"line {fault.line}: {mistake}", example) for mistake in found]
    _refuse(mistakes)


def _meant_devices(fault: Fault, scene: Scene, devices: Sequence[str]) -> Sequence[str]:
    """Return the devices of which one is meant: that of the arm in the fault's role for a fault of an arm."""
    if fault.kind.device not in CYCLES_OF:
        return devices
    its_device = _controller_of(scene.arms.get(fault.role, scene.arm))
    return (its_device,) if its_device in devices else devices


def _most_alike(fault: Fault, devices: Sequence[str]) -> FaultKind:
    """Return the kind of fault of these devices that comes nearest by spelling."""
    if fault.kind.device in devices:
        return fault.kind
    by_phrase = {kind.phrase: kind for kind in FAULT_KINDS if kind.device in devices}
    return by_phrase[find_near(fault.kind.phrase, by_phrase, least_alike=0.0)[0]]


def _example_of(kind: FaultKind, role: ArmRole) -> str:
    """Return an example of a kind of fault, of the arm in the role that was written."""
    return kind.example if role is ArmRole.MASTER else kind.example.replace(": ", f": {role} ", 1)


def _list_mistakes(fault: Fault, scene: Scene, devices: Sequence[str]) -> Iterator[str]:
    if fault.kind.device not in devices:
        yield f"expected a fault of the {join_choices(devices)}, got {fault.phrase!r}: no other device here"
        return
    yield from _list_excesses(fault)
    if fault.cycle is not None and fault.kind.device not in CYCLES_OF:
        yield f"expected a time: only the robot counts cycles, not the {fault.kind.device}"
    is_of_other = fault.role is not ArmRole.MASTER
    if is_of_other and fault.kind.device not in CYCLES_OF:
        yield f"expected a fault of the robot, got {fault.phrase!r}: only an arm can be the {fault.role}"
    elif fault.role not in scene.arms:
        yield f"expected a fault of the only arm, got {fault.phrase!r}: there is no {fault.role} here"
    elif (
        fault.kind.device in CYCLES_OF
        and len(scene.arms) > 1
        and (device := _controller_of(scene.arms[fault.role])) != fault.kind.device
    ):
        own = f"{fault.role} {device}" if is_of_other else device
        make = f"the {fault.role} here is made by {MAKES[device].name}, its faults begin with {own!r}"
        yield f"expected a fault of the {device}, got {fault.phrase!r}: {make}"
    for check in fault.kind.checks:
        yield from check(fault.arguments, scene)


def _list_excesses(fault: Fault) -> Iterator[str]:
    """Yield a mistake for each time and each number that is beyond what its unit allows."""
    lasts_s = 0.0 if math.isinf(fault.duration_s) else fault.duration_s
    quantities = [("s", one_s) for one_s in (fault.at_s or 0.0, fault.after_s, lasts_s)]
    quantities += [(unit, float(fault.arguments[place])) for place, unit in fault.kind.units.items()]
    for unit, quantity in quantities:
        if abs(quantity) > LARGEST[unit]:
            yield f"expected at most {LARGEST[unit]:g} {unit}, got {quantity:g}"


class Mistake(NamedTuple):
    """Error in a line, with an example of a valid line and a suggested correction.

    Only the first mistake of a script gives advice.
    """

    what: str
    example: str = EXAMPLE
    meant: str | None = None


def _refuse(mistakes: list[Mistake]) -> None:
    if mistakes:
        what = "; ".join(mistake.what for mistake in mistakes)
        first = mistakes[0]
        write = f"Did you mean: {first.meant}?" if first.meant else f"Write for example: {first.example}."
        raise BadFaultScript(what, action=f"{write} `ronna-sim fault` lists all faults.")


def _describe_unexpected(error: UnexpectedInput, line: str, number: int, *, advises: bool) -> Mistake:
    """Describe where the parser stopped, and search for the intended line only if `advises` is set."""
    names, column, word_began, ended = _locate(error, line)
    got = "the end of the line" if ended else repr(line[word_began:].split()[0])
    words = sorted(
        {READABLE.get(name) or repr(_build_grammar().get_terminal(name).pattern.value) for name in names}
    )
    if not ended and word_began < column - 1:
        words = [repr(line[word_began : column - 1])]
    words = words or ["the end of the line"]
    typed = line.removeprefix(BEGINS_NOW)
    fault = _strip_beginning(typed)
    device = next((kind.device for kind in FAULT_KINDS if fault.split()[:1] == [kind.device]), None)
    near: NearWord | None = None
    if len(words) > MOST_LISTED:  # only after a device
        words = [f"a fault of the {device}"]
        if not ended:
            got = f"{fault.split(maxsplit=1)[1].partition(' for ')[0]!r}: it has no such fault"
            near = _find_named_word(typed, device)
    place = f"line {number}, column {column - len(line) + len(typed)}"
    if not has_beginning(line) and _is_valid_line(f"{BEGINS_NOW}{line}"):
        what = f"{place}: expected 'at', 'when' or 'since', to say when the fault begins, got {got}"
        return Mistake(what, EXAMPLE, f"at 12.5 s: {line}")
    lacking = _count_direction(line[:word_began]) if words == [READABLE["SIGNED"]] else None
    if lacking is not None:
        words = [f"three numbers, for {join_choices(DIRECTION).replace(' or ', ' and ')}"]
        got = f"{'one' if lacking == 1 else 'two'} before {got}"
    what = f"{place}: expected {join_choices(words)}, got {got}"
    if not advises:
        return Mistake(what)
    if (completed := _add_missing_words(line)) is not None:
        completed = completed.removeprefix(BEGINS_NOW)
        return Mistake(what, completed) if lacking is not None else Mistake(what, meant=completed)
    wrong_argument = all(word in READABLE.values() for word in words)  # the parser's words say it best
    intended = None if wrong_argument else _find_intended_line(typed, device)
    if intended is None and near is not None:
        return Mistake(f"{what}; its nearest word is {near.word}", near.line)
    return Mistake(what, _find_nearest_example(typed, device), intended)


class NearWord(NamedTuple):
    """Word of a device's faults that is like the typed ones, and a line with it."""

    word: str
    line: str


class Stop(NamedTuple):
    """Place where the parser stopped: the terminals allowed there, its column, and where its word begins."""

    names: set[str]
    column: int
    word_began: int
    ended: bool


def _locate(error: UnexpectedInput, line: str) -> Stop:
    from lark.exceptions import UnexpectedCharacters, UnexpectedToken

    names: set[str] = set()
    ended = False
    if isinstance(error, UnexpectedCharacters):
        names = set(error.allowed or ())
    elif isinstance(error, UnexpectedToken):
        names, ended = set(error.accepts or error.expected), error.token.type == END
    column = len(line) + 1 if ended else error.column
    word_began = column - 1  # a unit that is spelt out begins like a unit: "sec"
    while not ended and word_began > 0 and line[word_began - 1 : column].isalpha():
        word_began -= 1
    return Stop(names - {END, END_OF_TEXT, "COMMENT", "WS_INLINE"}, column, word_began, ended)


def _count_direction(before: str) -> int | None:
    """Return how many numbers of a direction end this beginning of a line, None if none does."""
    found = _NUMBERS_BEFORE.search(before)
    count = 0 if found is None else len(found["numbers"].split()) - (found["word"] in _NUMBERED)
    return count if 0 < count < len(DIRECTION) else None


def _add_missing_words(line: str) -> str | None:
    """Return the line with the units and the zeros that it lacks, or None if it is wrong otherwise too."""
    from lark.exceptions import UnexpectedInput

    for _ in range(MOST_ADDED):
        try:
            _build_grammar().parse(line)
        except UnexpectedInput as error:
            names, _, place, _ = _locate(error, line)
            before, after = line[:place].rstrip(), line[place:]
            if len(names) != 1 or not before[-1:].isdigit():
                return None
            (name,) = names
            word = _build_grammar().get_terminal(name).pattern.value
            if name == "SIGNED" and _count_direction(before) is not None:
                word = "0"
            elif word not in LARGEST:
                return None
            line = f"{before} {word}{'' if after[:1] in ('', ':') else ' '}{after}"
        else:
            return line
    return None


def _find_named_word(line: str, device: str | None) -> NearWord | None:
    """Return the name most like the words after the device, such as that of a body to be moved."""
    fault = _strip_beginning(line)
    typed = fault.split(maxsplit=1)[1]
    by_word = {
        word: kind
        for kind in reversed(FAULT_KINDS)  # the first one that has the word
        if kind.device == device and "NAME" in kind.phrase.split()
        for word in kind.choices
    }
    words = _WORDS.match(typed.partition(" for ")[0])
    near = find_near(words[0], by_word, least_alike=LEAST_ALIKE) if words else []
    if not words or not near:
        return None
    kind = by_word[near[0]]
    beginning = line[: len(line) - len(fault)]
    renamed = f"{kind.device} {kind.phrase.partition(' NAME')[0]} {near[0]}{typed[words.end() :]}"
    whole = f"{beginning}{renamed}"
    completed = _add_missing_words(whole if has_beginning(whole) else f"{BEGINS_NOW}{whole}")
    if completed is not None:
        return NearWord(near[0], completed.removeprefix(BEGINS_NOW))
    return NearWord(near[0], kind.example.replace(f" {kind.choices[0]} ", f" {near[0]} ", 1))


def _is_valid_line(line: str) -> bool:
    from lark.exceptions import UnexpectedInput

    try:
        _build_grammar().parse(line)
    except UnexpectedInput:
        return False
    return True


@cache
def _build_grammar() -> Lark:
    from lark import Lark

    alternatives = []
    for kind in FAULT_KINDS:
        words = (kind.device, *kind.phrase.split())
        symbols = " ".join(word if word in TERMINALS else f'"{word}"' for word in words)
        alternatives.append(f"{symbols} -> {kind.name}")
    faults = "\n      | ".join(alternatives)
    return Lark(GRAMMAR.replace("{faults}", faults).replace("{step}", STEP), parser="lalr")


def _build_fault(statement: Any, line: int) -> tuple[Fault, bool]:
    """Build the fault from a parsed line, and return whether the line states a duration."""
    trigger, phrase, *ending = statement.children
    role = ArmRole.ASSISTANT if statement.data == OF_ASSISTANT else ArmRole.MASTER
    kind = next(kind for kind in FAULT_KINDS if kind.name == phrase.data)
    duration_s = float(ending[0].children[0]) if ending else (0.0 if kind.momentary else math.inf)
    begin = str(trigger.children[0]) if trigger.children else "0"
    fault = Fault(
        kind=kind,
        arguments=tuple(str(argument) for argument in phrase.children),
        duration_s=duration_s,
        at_s=float(begin) if trigger.data in ("at", NOW) else None,
        step=begin if trigger.data in ("when", SINCE) else None,
        lasts=trigger.data == SINCE,
        after_s=float(trigger.children[1]) if len(trigger.children) > 1 else 0.0,
        cycle=int(begin) if trigger.data == "at_cycle" else None,
        line=line,
        role=role,
    )
    return fault, bool(ending)


def _find_nearest_example(line: str, device: str | None) -> str:
    """Return an example of the kind of fault whose phrase best matches the line, of its device if known."""
    fault = _strip_beginning(line)
    by_usage = {kind.usage: kind for kind in FAULT_KINDS if device in (kind.device, None)}
    nearest = _find_nearest(fault, [*by_usage], 1, least_alike=0.0 if device else LEAST_ALIKE)
    before = line[: len(line) - len(fault)].rstrip()
    role = next((role for role in OTHER_ARMS if before.endswith(role)), ArmRole.MASTER)
    return _example_of(by_usage[nearest[0]], role) if nearest else EXAMPLE


def _find_intended_line(line: str, device: str | None) -> str | None:
    """Return the closest valid line that keeps the numbers and names, or None if none is close.

    Which make an arm is was no slip of the pen: a line of one keeps its device.
    """
    fault = _strip_beginning(line)
    beginning = line[: len(line) - len(fault)]
    phrase, lasts, duration = fault.partition(" for ")
    kinds = [kind for kind in FAULT_KINDS if device not in CYCLES_OF or kind.device == device]
    filled = [one for kind in kinds for one in _fill_phrase(kind, phrase.split())]
    for nearest in _find_nearest(phrase, filled, MOST_TRIED):
        whole = f"{beginning}{nearest}{lasts}{duration}".strip()
        if _is_valid_line(whole if has_beginning(whole) else f"{BEGINS_NOW}{whole}"):
            return whole
    return None


def _strip_beginning(line: str) -> str:
    """Strip the start time or trigger of a line and whose fault it is, if any."""
    found = _BEGINNING.match(line)
    return line[found.end() :] if found else line


def _fill_phrase(kind: FaultKind, words: Sequence[str]) -> Iterator[str]:
    """Yield the phrase of a kind with the typed words as its arguments."""
    phrase = [kind.device, *kind.phrase.split()]
    for typed in (words, [kind.device, *words]):  # the device is easily forgotten
        if len(typed) in (len(phrase), len(phrase) - 1):  # so is the unit at the end
            pairs = zip(phrase, [*typed, ""], strict=False)
            filled = [word if known in TERMINALS else known for known, word in pairs]
            arguments = [word for known, word in zip(phrase, filled, strict=True) if known in TERMINALS]
            known_one = not (arguments and kind.choices) or arguments[0] in kind.choices
            if any(known != word and word in OTHER_UNITS for known, word in zip(phrase, typed, strict=False)):
                continue  # its number is not of the unit that belongs there
            if all(filled) and known_one and all(map(_ARGUMENT.fullmatch, arguments)):
                yield " ".join(filled)


def _find_nearest(
    text: str, known: Sequence[str], count: int, *, least_alike: float = LEAST_ALIKE
) -> list[str]:
    return find_near(text, known, count, least_alike=least_alike)
