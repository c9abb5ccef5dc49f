"""The room of a simulated theatre in a person's hands: move, hide, disturb, and look up the truth.

    with simulated_theatre("mini") as theatre, theatre.tracker.active() as tracker:
        theatre.room.hide("sphere 2")
        theatre.room.move("head", (0.0, 1.0, 0.0))
        print(tracker.read_frame().strays, theatre.room.truth().spheres)
        print(theatre.room.why("sphere 2"))

The truth is told by theatres of `simulated_theatre` alone: a case, its steps and drivers cannot ask for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arguments import WrongArgument, require_numbers, show
from ronna_hw.control_port import ask_control_port
from ronna_hw.vectors import JointVector, Vector3, vector3

SPHERE = "sphere "  # followed by its number


@dataclass(frozen=True)
class TrueSphere:
    """One sphere on the head: where it is, and whether the tracker sees it, or why not."""

    number: int
    tracker_mm: Vector3
    seen: bool
    because: str


@dataclass(frozen=True)
class RoomTruth:
    """Places in a room at a theatre time. Phantoms are points where lines of sight of two spheres cross.

    `disturbances` of the whole tracker, such as sunlight, add reflections that are no sphere.
    """

    theatre_time_s: float
    joints_rad: Mapping[str, JointVector]  # by role of the arm
    spheres: tuple[TrueSphere, ...]
    phantoms_mm: NDArray[np.float64]  # (n, 3), tracker frame
    disturbances: tuple[str, ...]

    def nearest(self, place_mm: Sequence[float]) -> TrueSphere:
        """Return the sphere nearest to a place in the tracker frame, such as that of a stray."""
        return min(self.spheres, key=lambda one: float(np.linalg.norm(np.subtract(one.tracker_mm, place_mm))))

    def is_phantom(self, place_mm: Sequence[float]) -> bool:
        """Whether a place is nearer to a phantom than to any sphere."""
        if not len(self.phantoms_mm):
            return False
        apart_mm = np.linalg.norm(self.phantoms_mm - np.asarray(place_mm), axis=1).min()
        return bool(apart_mm < np.linalg.norm(np.subtract(self.nearest(place_mm).tracker_mm, place_mm)))


class SimulatedRoom:
    """Hands in a simulated theatre, at its control port. Raises CTL-001 and CTL-002 as the port.

    Once the theatre is closed, every call raises DEV-010.
    """

    def __init__(self, control: str, require_open: Callable[[], None]) -> None:
        self._control = control
        self._require_open = require_open

    def inject(self, line: str) -> str:
        """Inject one line of a fault script, such as `tracker occlude marker 2 for 2 s`; return its effect.

        A line without a time begins now.
        """
        return str(self._ask("fault", line=line)["effect"])

    def clear(self, line: str | None = None) -> None:
        """End what was injected, by its line, or all of it: what was moved is back in its place."""
        self._ask("clear_faults", **({} if line is None else {"line": line}))

    def move(self, what: str, by_mm: Sequence[float]) -> None:
        """Move head, cart, assistant_cart, tracker or guide along the robot's axes, until cleared."""
        self.inject(f"room shift {what} {_numbers(by_mm)} mm")

    def turn(self, what: str, by_deg: Sequence[float]) -> None:
        """Turn a body about its own point by a rotation vector along the robot's axes."""
        self.inject(f"room turn {what} {_numbers(by_deg)} deg")

    def hide(self, what: str, for_s: float | None = None) -> None:
        """Hide a sphere, as `sphere 2`, or a tool by its name: for a time, or until cleared."""
        until = "" if for_s is None else f" for {for_s:g} s"
        self.inject(f"{_occlusion(what)}{until}")

    def show(self, what: str) -> None:
        """Show again what `hide` has hidden until cleared."""
        self.clear(_occlusion(what))

    def mount(self, number: int) -> None:
        """Mount a tool: 0 none, 1 the stereo head, 2 the guide."""
        self._ask("mount", number=number)

    def truth(self) -> RoomTruth:
        """Return where everything is now. Raises CTL-002 in a theatre that does not tell it."""
        told = self._ask("truth")
        return RoomTruth(
            float(told["theatre_time_s"]),
            {role: tuple(map(float, joints)) for role, joints in told["joints_rad"].items()},
            tuple(
                TrueSphere(
                    int(one["number"]), vector3(one["tracker_mm"]), bool(one["seen"]), str(one["because"])
                )
                for one in told["spheres"]
            ),
            np.array(told["phantoms_mm"], dtype=float).reshape(-1, 3),
            tuple(map(str, told["disturbances"])),
        )

    def why(self, what: str) -> str:
        """Say whether the tracker sees a sphere, as `sphere 2`, and if not, why. Raises ARG-001."""
        spheres = self.truth().spheres
        for one in spheres:
            if what == f"{SPHERE}{one.number}":
                return one.because
        known = ", ".join(f"{SPHERE}{one.number}" for one in spheres)
        raise WrongArgument(
            "there is no such sphere", expected=known or "a scene with a head", got=show(what)
        )

    def _ask(self, action: str, **arguments: Any) -> dict[str, Any]:
        self._require_open()
        return ask_control_port(self._control, action, **arguments)


def _occlusion(what: str) -> str:
    if not isinstance(what, str):
        raise WrongArgument(
            "what is hidden is no name", expected="sphere 2, or a tool's name", got=show(what)
        )
    number = what.removeprefix(SPHERE)
    return f"tracker occlude {f'marker {number}' if what.startswith(SPHERE) else f'tool {what}'}"


def _numbers(values: Sequence[float]) -> str:
    x, y, z = require_numbers(values, "the displacement", shape=(3,)).tolist()
    return f"{x:+.6f} {y:+.6f} {z:+.6f}"
