"""Scripted faults and fault kinds: phrase, checks against a scene, and meaning."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from sim.world.options import ArmRole
from sim.world.scene.model import Scene

Arguments = tuple[str, ...]
Check = Callable[[Arguments, Scene], Iterable[str]]

LARGEST: Mapping[str, float] = {  # of a number in a fault, by the unit written after it
    "%": 100.0,
    "mm": 2000.0,  # twice the reach of the arm: from there, nothing that was within reach still is
    "mm per min": 2000.0,
    "deg": 180.0,
    "deg per min": 180.0,
    "N": 1000.0,
    "kg": 50.0,
    "s": 100_000.0,  # longer than a day
    "ms": 60_000.0,
    "cycles": 1000.0,
    "frames": 1000.0,
    "px": 1000.0,
    "spots": 500.0,
    "bytes": 65_535.0,  # of a datagram
    "ppm": 1_000_000.0,  # a clock at twice its rate
    "tools": 100.0,
    "handles": 100.0,
}

# Arguments as terminals of the grammar, and as shown in usage and examples.
USAGE = (("INT", "N"), ("NUMBER", "X"), ("SIGNED", "±X"))
EXAMPLE = (
    ("INT bytes", "1500 bytes"),
    ("cart INT", "cart 1"),
    ("INT", "2"),
    ("NUMBER", "5"),
    ("SIGNED", "-1.5"),
)
EXAMPLE_NAME = "robot_frame"  # a tool
TERMINALS = ("INT", "NUMBER", "SIGNED", "NAME")
_TERMINAL = re.compile(rf"\b({'|'.join(TERMINALS)})\b")
_UNITS = "|".join(sorted(LARGEST, key=len, reverse=True))
_QUANTITY = re.compile(rf"\b(INT|NUMBER|SIGNED)((?: \1)*) ({_UNITS})(?= |$)")


@dataclass(frozen=True)
class Fault:
    """A scripted fault, whose start is given by `at_s`, `step` or `cycle`."""

    kind: FaultKind
    arguments: Arguments
    duration_s: float  # theatre time; 0 for a momentary fault, infinite without an end
    at_s: float | None = None
    step: str | None = None
    lasts: bool = False  # beyond the step
    after_s: float = 0.0  # delay from the first start of the step
    cycle: int | None = None  # of the robot's controller
    line: int = 1  # of the script
    role: ArmRole = ArmRole.MASTER  # of its arm, for a fault of one

    @property
    def argument(self) -> str:
        """First argument, or an empty string if there are none."""
        return self.arguments[0] if self.arguments else ""

    @property
    def device_phrase(self) -> str:
        """The fault of its device, whichever the arm."""
        words = iter(self.arguments)
        phrase = (next(words) if word in TERMINALS else word for word in self.kind.phrase.split())
        return " ".join((self.kind.device, *phrase))

    @property
    def phrase(self) -> str:
        """The fault as written in a script, without its start and duration."""
        return self.device_phrase if self.role is ArmRole.MASTER else f"{self.role} {self.device_phrase}"

    @property
    def effect(self) -> str:
        """Description of effect and timing for the person injecting the fault."""
        begins = "from now on" if self.at_s is None else f"from theatre time {self.at_s:.3f} s on"
        if self.step is not None:
            later = f"{self.after_s:g} s after " if self.after_s else "when "
            begins = f"{later if self.lasts else 'whenever '}step {self.step} begins"
        if self.cycle is not None:
            begins = f"from cycle {self.cycle} on"
        lasts = "until cleared" if math.isinf(self.duration_s) else f"for {self.duration_s:g} s"
        if self.step is not None and not self.lasts:
            lasts = "until that step ends" if math.isinf(self.duration_s) else f"{lasts} of that step"
        duration = "once" if self.kind.momentary else lasts
        return f"{self.phrase}, {begins}, {duration}. {self.kind.meaning}"

    def onset_s(self, step: str, step_started_s: float, cycle_began_s: Callable[[int], float]) -> float:
        """Return the theatre time of the onset, infinite until its step or cycle has begun."""
        if self.at_s is not None:
            return self.at_s
        if self.cycle is not None:
            return cycle_began_s(self.cycle)
        if self.begins_in(step) and not self.lasts:  # the control port sets a time for lasting ones
            return step_started_s
        return math.inf

    def same_as(self, other: Fault) -> bool:
        """Return whether two faults are the same, regardless of their script lines."""
        return replace(self, line=other.line) == other

    def begins_in(self, step: str) -> bool:
        """Return whether the fault begins with the given step."""
        return self.step in (step, step.partition(":")[0])


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault that a device can have.

    `phrase` is the text between the device's name and `for`: words verbatim, arguments as terminals of the
    grammar (`occlude marker INT`, `drop NUMBER %`). A lasting fault acts for its duration, or until cleared
    without one; a momentary fault happens once and has none. `checks` yield mistakes in the arguments for a
    scene: "expected X, got Y".
    """

    name: str
    device: str  # "tracker", "robot", "camera" or "room"
    phrase: str
    meaning: str  # one sentence for the reference page
    momentary: bool
    checks: tuple[Check, ...]

    @cached_property
    def usage(self) -> str:
        """Phrase with its arguments in readable form."""
        return _replace_words(f"{self.device} {self.phrase}", USAGE)

    @cached_property
    def units(self) -> Mapping[int, str]:
        """Units by the place of an argument, of the numbers that have one."""
        units: dict[int, str] = {}
        for found in _QUANTITY.finditer(self.phrase):
            first = len(_TERMINAL.findall(self.phrase[: found.start()]))
            units |= dict.fromkeys(range(first, first + len(found[2].split()) + 1), found[3])
        return units

    @property
    def choices(self) -> Sequence[str]:
        """Words allowed as the first argument, empty if unrestricted or dependent on the scene."""
        return next((check.known for check in self.checks if isinstance(check, OneOf)), ())

    @property
    def example(self) -> str:
        """Example of a complete script line."""
        name = self.choices[0] if self.choices else EXAMPLE_NAME
        phrase = _replace_words(f"{self.device} {self.phrase}", (*EXAMPLE, ("NAME", name)))
        return f"at 12.5 s: {phrase}" + ("" if self.momentary else " for 2 s")


class FaultKinds:
    """Declares the fault kinds of one device, and lists them as `declared`.

    `prefix` distinguishes their names from those of other devices; `first` checks every first argument.
    """

    def __init__(self, device: str, prefix: str = "", first: Check | None = None) -> None:
        self.declared: list[FaultKind] = []
        self._device = device
        self._prefix = prefix
        self._first = () if first is None else (first,)

    def declare_lasting(self, name: str, phrase: str, meaning: str, *checks: Check) -> FaultKind:
        """Declare a kind of fault that lasts for a duration."""
        return self._declare(name, phrase, meaning, checks, momentary=False)

    def declare_momentary(self, name: str, phrase: str, meaning: str, *checks: Check) -> FaultKind:
        """Declare a kind of fault that occurs once."""
        return self._declare(name, phrase, meaning, checks, momentary=True)

    def _declare(
        self, name: str, phrase: str, meaning: str, checks: tuple[Check, ...], *, momentary: bool
    ) -> FaultKind:
        checks = (*self._first, *checks)
        kind = FaultKind(self._prefix + name, self._device, phrase, meaning, momentary, checks)
        self.declared.append(kind)
        return kind


@dataclass(frozen=True)
class OneOf:
    """Check that the first argument is a known word."""

    what: str
    known: Sequence[str]

    def __call__(self, arguments: Arguments, _scene: Scene) -> Iterator[str]:
        yield from unless_known(self.what, self.known, arguments[0])


def check_at_most(largest: float, unit: str, *, argument: int = 0) -> Check:
    """Check that a numeric argument does not exceed a limit."""

    def check(arguments: Arguments, _scene: Scene) -> Iterator[str]:
        if float(arguments[argument]) > largest:
            yield f"expected at most {largest:g} {unit}, got {arguments[argument]}"

    return check


def unless_known(what: str, known: Sequence[str], got: str) -> Iterator[str]:
    """Yield an error message unless the word is known."""
    if got not in known:
        yield f"expected {what} {join_choices(known)}, got {got}"


def join_choices(words: Sequence[str]) -> str:
    """Join words as in `a, b or c`."""
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def fiducial_number(arguments: Arguments, scene: Scene) -> Iterator[str]:
    """Check that the first argument is the number of a fiducial in the scene."""
    yield from unless_known(
        "marker", [str(fiducial.number) for fiducial in scene.head.fiducials], arguments[0]
    )


def _replace_words(phrase: str, words: Iterable[tuple[str, str]]) -> str:
    for word, value in words:
        phrase = phrase.replace(word, value)
    return phrase
