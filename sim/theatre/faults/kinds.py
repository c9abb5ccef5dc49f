"""A kind of fault: its phrase in a script, what it requires of the scene, and what it means."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from sim.theatre.scene.model import Scene

Arguments = tuple[str, ...]
Check = Callable[[Arguments, Scene], Iterable[str]]

WHOLE_PERCENT = 100.0


def _anything(_arguments: Arguments, _scene: Scene) -> Iterator[str]:
    yield from ()


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault of one device.

    `phrase` is what stands between the device's name and `for`: words as they are written, arguments as
    the grammar's terminals INT, NUMBER, SIGNED, NAME and HEX (`occlude marker INT`, `drop NUMBER %`). A
    lasting fault acts for its duration, or to the end when none is given; a momentary one happens once and
    has none.
    `check` yields what is wrong with the arguments in a scene, in words that begin with "there is" or the
    value itself.
    """

    name: str
    device: str  # "tracker", "robot" or "camera"
    phrase: str
    meaning: str  # one sentence for the reference page
    momentary: bool = False
    check: Check = _anything

    @property
    def usage(self) -> str:
        """The phrase in readable form."""
        words = {"INT": "N", "NUMBER": "X", "SIGNED": "±X", "NAME": "NAME", "HEX": "HEX"}
        return " ".join([self.device, *(words.get(word, word) for word in self.phrase.split())])


def at_most_all(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    """Check a percentage."""
    if float(arguments[0]) > WHOLE_PERCENT:
        yield f"{arguments[0]} % is more than 100 %"
