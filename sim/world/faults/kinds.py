"""A kind of fault: its phrase in a script, what it requires of the scene, and what it means."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from sim.world.scene.model import Scene

Arguments = tuple[str, ...]
Check = Callable[[Arguments, Scene], Iterable[str]]

WHOLE_PERCENT = 100.0
# Arguments as terminals of the grammar, and as shown in usage and examples.
USAGE = (("INT", "N"), ("NUMBER", "X"), ("SIGNED", "±X"))
EXAMPLE = (("INT bytes", "1500 bytes"), ("INT", "2"), ("NUMBER", "5"), ("SIGNED", "-1.5"))
EXAMPLE_NAME = "robot_frame"  # of a tool
TERMINALS = ("INT", "NUMBER", "SIGNED", "NAME")


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault of one device.

    `phrase` is the text between the device's name and `for`: words verbatim, arguments as terminals of the
    grammar (`occlude marker INT`, `drop NUMBER %`). A lasting fault acts for its duration, or to the end if
    none is given; a momentary one happens once and has none. `check` yields what is wrong with the arguments
    in a scene: "expected X, got Y".
    """

    name: str
    device: str  # "tracker", "robot", "camera" or "room"
    phrase: str
    meaning: str  # one sentence for the reference page
    momentary: bool
    check: Check

    @cached_property
    def usage(self) -> str:
        """The phrase in readable form."""
        return _replaced(f"{self.device} {self.phrase}", USAGE)

    @property
    def choices(self) -> Sequence[str]:
        """The words that the first argument may be; none if any, or if that depends on the scene."""
        check = self.check.first if isinstance(self.check, Both) else self.check
        return check.known if isinstance(check, OneOf) else ()

    @property
    def example(self) -> str:
        """A whole line of a script."""
        name = self.choices[0] if self.choices else EXAMPLE_NAME
        phrase = _replaced(f"{self.device} {self.phrase}", (*EXAMPLE, ("NAME", name)))
        return f"at 12.5 s: {phrase}" + ("" if self.momentary else " for 2 s")


def anything(_arguments: Arguments, _scene: Scene) -> Iterator[str]:
    """No check."""
    yield from ()


@dataclass(frozen=True)
class OneOf:
    """Checks that the first argument is one of the known ones."""

    what: str
    known: Sequence[str]

    def __call__(self, arguments: Arguments, _scene: Scene) -> Iterator[str]:
        yield from expected(self.what, self.known, arguments[0])


def at_most(largest: float, unit: str, *, argument: int = 0) -> Check:
    """Check that an argument does not exceed a limit."""

    def check(arguments: Arguments, _scene: Scene) -> Iterator[str]:
        if float(arguments[argument]) > largest:
            yield f"expected at most {largest:g} {unit}, got {arguments[argument]}"

    return check


@dataclass(frozen=True)
class Both:
    """Applies two checks."""

    first: Check
    second: Check

    def __call__(self, arguments: Arguments, scene: Scene) -> Iterator[str]:
        yield from self.first(arguments, scene)
        yield from self.second(arguments, scene)


def expected(what: str, known: Sequence[str], got: str) -> Iterator[str]:
    """The mistake, unless the value is one of the known ones."""
    if got not in known:
        yield f"expected {what} {either(known)}, got {got}"


def either(words: Sequence[str]) -> str:
    """`a, b or c`."""
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def fiducial_number(arguments: Arguments, scene: Scene) -> Iterator[str]:
    """Check that the first argument is the number of a fiducial of the scene."""
    yield from expected("marker", [str(fiducial.number) for fiducial in scene.head.fiducials], arguments[0])


class DeviceFaults:
    """Declares the kinds of fault of one device.

    `prefix` distinguishes their names from those of other devices; `first` checks the first argument of each.
    """

    def __init__(self, device: str, prefix: str = "", first: Check | None = None) -> None:
        self._device = device
        self._prefix = prefix
        self._first = first

    def lasting(self, name: str, phrase: str, meaning: str, check: Check = anything) -> FaultKind:
        """A fault that acts for its duration."""
        return self._kind(name, phrase, meaning, check, momentary=False)

    def once(self, name: str, phrase: str, meaning: str, check: Check = anything) -> FaultKind:
        """A fault that happens once."""
        return self._kind(name, phrase, meaning, check, momentary=True)

    def share(self, name: str, phrase: str, meaning: str) -> FaultKind:
        """A lasting fault of a percentage, after the first argument if that is checked."""
        percent = at_most(WHOLE_PERCENT, "%", argument=0 if self._first is None else 1)
        return self.lasting(name, phrase, meaning, percent)

    def _kind(self, name: str, phrase: str, meaning: str, check: Check, *, momentary: bool) -> FaultKind:
        if self._first is not None:
            check = self._first if check is anything else Both(self._first, check)
        return FaultKind(self._prefix + name, self._device, phrase, meaning, momentary, check)


def _replaced(phrase: str, words: Iterable[tuple[str, str]]) -> str:
    for word, value in words:
        phrase = phrase.replace(word, value)
    return phrase
