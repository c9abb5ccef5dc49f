"""The room of a simulated theatre in a person's hands: move, hide, disturb, and look up the truth.

    with simulated_theatre("mini") as theatre, theatre.tracker.active() as tracker:
        theatre.room.hide("sphere 2")
        theatre.room.move("head", (0.0, 1.0, 0.0))
        print(tracker.read_frame().strays, theatre.room.truth().spheres)
        print(theatre.room.why("sphere 2"))

Only theatres of `simulated_theatre` and of --tell-truth tell the truth. No run is accepted in them (CTL-004),
so no step and no driver of a case can ask for it.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arguments import WrongArgument, show
from ronna_hw.control_port import ControlRequestRefused, ask_control_port
from ronna_hw.frames import Frame
from ronna_hw.near_names import did_you_mean
from ronna_hw.room_truth import IN_VIEW, SPHERE, RoomTruth, read_truth, require_vector

BODIES = ("head", "cart", "assistant_cart", "tracker", "guide", "seat")  # that can be moved and turned
TOOLS = (0, 1, 2)  # none, stereo head, guide
EXTRA_SPHERE = f"extra {SPHERE}"  # followed by its number
FARTHEST_MM, FARTHEST_DEG, LONGEST_S = (
    2000.0,
    180.0,
    100_000.0,
)  # that the fault scripts of the simulators take
SAME_PLACE_MM = 0.001  # lines of a fault script have places to a thousandth of that
_HIDDEN = re.compile(rf"(?:{SPHERE}(?P<number>[0-9]+)|(?P<tool>[A-Za-z0-9_][A-Za-z0-9_.-]*))")


class UnseenSphereWarning(UserWarning):
    """A sphere was placed where the tracker does not see it, or outside its measuring volume."""


class SimulatedRoom:
    """Hands in a simulated theatre, at its control port. Raises CTL-001 and CTL-002 as the port.

    Calls with a wrong argument raise ARG-001. Once the theatre is closed, every call raises DEV-010.
    """

    def __init__(
        self,
        control: str,
        require_open: Callable[[], None],
        list_tools: Callable[[], Sequence[str]] = lambda: (),
    ) -> None:
        """Reach into the room at a control port; `list_tools` are the tools to suggest."""
        self._control = control
        self._require_open = require_open
        self._list_tools = list_tools

    def __repr__(self) -> str:
        return f"<SimulatedRoom: {', '.join(name for name in dir(type(self)) if name[0] != '_')}>"

    def inject(self, line: str) -> str:
        """Inject one line of a fault script, such as `tracker occlude marker 2 for 2 s`; return its effect.

        A line without a time begins now.
        """
        if not isinstance(line, str):
            raise WrongArgument("the line is no text", expected="a line of a fault script", got=show(line))
        return str(self._ask("fault", line=line)["effect"])

    def clear(self, line: str | None = None) -> None:
        """End what was injected, by its line, or all of it: what was moved is back in its place."""
        if not isinstance(line, str | None):
            raise WrongArgument("the line is no text", expected="a line that was injected", got=show(line))
        self._ask("clear_faults", **({} if line is None else {"line": line}))

    def move(self, what: str, by_mm: Sequence[float]) -> None:
        """Move head, cart, assistant_cart, tracker, guide or seat along the robot's axes, until cleared.

        The seat moves along the axes of the guide's calibrated tip.
        """
        self.inject(f"room shift {_require_body(what)} {_numbers(by_mm, 'displacement', FARTHEST_MM, 'mm')}")

    def turn(self, what: str, by_deg: Sequence[float]) -> None:
        """Turn a body about its own point by a rotation vector along the robot's axes."""
        self.inject(f"room turn {_require_body(what)} {_numbers(by_deg, 'turn', FARTHEST_DEG, 'deg')}")

    def hide(self, what: str, for_s: float | None = None) -> None:
        """Hide a sphere, as `sphere 2`, or a tool by its name: for a time, or until cleared.

        An extra sphere is not hidden but taken away, by `clear` with the line of `place_sphere`.
        """
        line = f"{_occlusion(what)}{_duration(for_s)}"
        try:
            self.inject(line)
        except ControlRequestRefused as error:
            raise _no_such("sphere or tool to hide", what, self._list_hideable()) from error

    def show(self, what: str) -> None:
        """Show again what `hide` has hidden until cleared."""
        line = _occlusion(what)
        try:
            self.clear(line)
        except ControlRequestRefused as error:
            raise WrongArgument(
                f"{what} is not hidden", expected="what hide() has hidden until cleared", got=show(what)
            ) from error

    def place_sphere(self, at_mm: Sequence[float], frame: Frame | str = "tracker") -> str:
        """Place one more sphere in the room, at a place in the tracker's frame or the robot's.

        The tracker sees it, the cameras do not. It rests there until `clear` ends the line that is returned.
        The truth names it `extra sphere 1` and so on. An UnseenSphereWarning says why the tracker does not
        see it there. Raises ARG-001 for another frame, and for a place that is too far or taken.
        """
        place = require_vector(at_mm, "sphere")
        if frame not in (Frame.TRACKER, Frame.ROBOT):
            raise WrongArgument(
                "a sphere is placed in another frame", expected="tracker or robot", got=show(str(frame))
            )
        before = self.truth()
        if frame == Frame.TRACKER:
            in_robot, in_tracker = before.robot_from_tracker.apply(place), place
        else:
            in_robot, in_tracker = place, before.robot_from_tracker.inverse().apply(place)
        if np.abs(in_robot).max() > FARTHEST_MM:
            raise WrongArgument(
                "the sphere would be too far from the robot",
                limit=f"{FARTHEST_MM:g} mm along each axis of the robot",
                got=f"{show(at_mm)} in the {frame}'s frame, {_round(in_robot)} in the robot's",
            )
        if taken := _extra_spheres_at(before, in_tracker):
            raise WrongArgument(f"{taken[0][0]} is at that place already", got=show(at_mm))
        line = f"room extra sphere {_script(in_robot)} mm"
        self.inject(line)
        for name, because in _extra_spheres_at(self.truth(), in_tracker):
            if because != IN_VIEW:
                text = f"{name} at {_round(in_tracker)} mm in the tracker's frame: {because}"
                warnings.warn(text, UnseenSphereWarning, stacklevel=2)
        return line

    def mount(self, number: int) -> None:
        """Mount a tool: 0 none, 1 the stereo head, 2 the guide."""
        if isinstance(number, bool) or number not in TOOLS:
            raise WrongArgument(
                "there is no such tool", expected="0 none, 1 the stereo head, 2 the guide", got=show(number)
            )
        self._ask("mount", number=number)

    def truth(self) -> RoomTruth:
        """Return where everything is now. Raises CTL-002 in a theatre that does not tell it."""
        return read_truth(self._ask("truth"))

    def why(self, what: str) -> str:
        """Say whether the tracker sees a sphere, as `sphere 2` or `extra sphere 1`, and if not, why.

        Other markers have the names that the truth has for them.
        """
        truth = self.truth()
        reasons = {sphere.name: sphere.because for sphere in truth.spheres}
        reasons |= {other.name: other.because for other in truth.others}
        if what not in reasons:
            raise _no_such("sphere or marker", what, reasons)
        return reasons[what]

    def _list_hideable(self) -> list[str]:
        try:
            spheres = [one.name for one in self.truth().spheres]
        except ControlRequestRefused:  # a theatre that does not tell the truth
            spheres = []
        return [*spheres, *self._list_tools()]

    def _ask(self, action: str, **arguments: Any) -> dict[str, Any]:
        self._require_open()
        return ask_control_port(self._control, action, **arguments)


def _require_body(what: object) -> object:
    if what not in BODIES:
        raise _no_such("body to move or turn", what, BODIES)
    return what


def _no_such(kind: str, what: object, known: Iterable[str]) -> WrongArgument:
    known = tuple(known)
    meant = did_you_mean(what, known) if isinstance(what, str) else ""
    return WrongArgument(
        f"there is no such {kind}",
        expected=", ".join(known) or "a scene with a head",
        got=show(what),
        action=meant or "Give one of these names.",
    )


def _extra_spheres_at(truth: RoomTruth, place_mm: NDArray[np.float64]) -> list[tuple[str, str]]:
    """Return name and sight of each extra sphere at a place in the tracker frame."""
    return [
        (one.name, one.because)
        for one in truth.others
        if one.name.startswith(EXTRA_SPHERE)
        and float(np.linalg.norm(np.subtract(one.tracker_mm, place_mm))) < SAME_PLACE_MM
    ]


def _occlusion(what: object) -> str:
    if isinstance(what, str) and what.startswith(EXTRA_SPHERE):
        raise WrongArgument(
            "an extra sphere is not hidden, it is taken away",
            got=show(what),
            action="Call clear() with the line that place_sphere returned.",
        )
    match = _HIDDEN.fullmatch(what) if isinstance(what, str) else None
    if match is None:
        raise WrongArgument(
            "what is hidden is no name",
            expected="sphere 2, or a tool's name; a time goes into for_s",
            got=show(what),
        )
    number = match["number"]
    return f"tracker occlude {f'tool {what}' if number is None else f'marker {number}'}"


def _duration(for_s: object) -> str:
    if for_s is None:
        return ""
    if isinstance(for_s, bool) or not isinstance(for_s, int | float) or not 0.0 < for_s <= LONGEST_S:
        raise WrongArgument(
            "for_s is no time",
            expected=f"seconds, more than 0 and at most {LONGEST_S:g}, or None until cleared",
            got=show(for_s),
        )
    return f" for {for_s:.6f} s"


def _numbers(values: Sequence[float], what: str, largest: float, unit: str) -> str:
    numbers = require_vector(values, what, unit)
    if np.abs(numbers).max() > largest:
        raise WrongArgument(
            f"the {what} is too large", limit=f"{largest:g} {unit} along each axis", got=show(values)
        )
    return f"{_script(numbers)} {unit}"


def _script(numbers: NDArray[np.float64]) -> str:
    return " ".join(f"{one:+.6f}" for one in numbers.tolist())


def _round(place_mm: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{one:.1f}' for one in place_mm.tolist())})"
