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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arguments import WrongArgument, require_numbers, show
from ronna_hw.control_port import ask_control_port
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector, Vector3, vector3

SPHERE = "sphere "  # followed by its number


@dataclass(frozen=True)
class TrueSphere:
    """One sphere on the head: where it is, and whether the tracker sees it, or why not.

    `seen` is true for one outside the measuring volume too, which is reported as a stray on request.
    `in_volume` judges the unit's first volume, even if a driver has selected another.
    """

    number: int
    tracker_mm: Vector3
    seen: bool
    in_volume: bool
    because: str


@dataclass(frozen=True)
class TrueMarker:
    """Another marker in the room, such as one of a tool: its name, and where it is."""

    name: str
    tracker_mm: Vector3


@dataclass(frozen=True)
class TruePhantom:
    """Point where the lines of sight of two markers cross: no marker is there. The left sensor's first."""

    of: tuple[str, str]
    tracker_mm: Vector3

    @property
    def name(self) -> str:
        """Name of the phantom by its markers."""
        return f"phantom of {' and '.join(self.of)}"


class Origin(StrEnum):
    """Kind of thing that a stray in a frame of the tracker comes from."""

    SPHERE = "sphere"  # on the head
    OTHER = "other marker"
    PHANTOM = "phantom"
    REFLECTION = "reflection"


class StrayOrigin(NamedTuple):
    """Source of a stray: its kind, its name, and how far the stray is from where it really is."""

    kind: Origin
    name: str
    off_mm: float


@dataclass(frozen=True)
class RoomTruth:
    """Places in a room at a theatre time, in the tracker's frame.

    A stray is one of `spheres` or `others`, a phantom where lines of sight of two markers cross, or a
    reflection: such a surface shines in some frames and wanders by millimetres. `disturbances` act on the
    whole tracker.
    """

    theatre_time_s: float
    joints_rad: Mapping[str, JointVector]  # by role of the arm
    spheres: tuple[TrueSphere, ...]
    others: tuple[TrueMarker, ...]
    phantoms: tuple[TruePhantom, ...]
    reflections_mm: NDArray[np.float64]  # (n, 3), where each surface is on average
    robot_from_tracker: Transform
    disturbances: tuple[str, ...]

    @property
    def phantoms_mm(self) -> NDArray[np.float64]:
        """Places of the phantoms, (n, 3)."""
        return np.array([one.tracker_mm for one in self.phantoms], dtype=float).reshape(-1, 3)

    def nearest(self, place_mm: Sequence[float]) -> TrueSphere:
        """Return the sphere nearest to a place in the tracker frame, such as that of a stray."""
        return min(self.spheres, key=lambda one: float(np.linalg.norm(np.subtract(one.tracker_mm, place_mm))))

    def origin_of(self, place_mm: Sequence[float]) -> StrayOrigin:
        """Return what a stray at a place comes from: whatever is nearest. Raises ARG-001 in an empty room."""
        place = require_numbers(place_mm, "the place of the stray", shape=(3,))
        candidates = [
            *((Origin.SPHERE, f"{SPHERE}{one.number}", one.tracker_mm) for one in self.spheres),
            *((Origin.OTHER, one.name, one.tracker_mm) for one in self.others),
            *((Origin.PHANTOM, one.name, one.tracker_mm) for one in self.phantoms),
            *(
                (Origin.REFLECTION, f"reflection {number}", tuple(one))
                for number, one in enumerate(self.reflections_mm.tolist(), 1)
            ),
        ]
        if not candidates:
            raise WrongArgument("nothing in this room is seen by a tracker", expected="a scene with a head")
        found = [
            StrayOrigin(kind, name, float(np.linalg.norm(np.subtract(there_mm, place))))
            for kind, name, there_mm in candidates
        ]
        return min(found, key=lambda one: one.off_mm)

    def is_phantom(self, place_mm: Sequence[float]) -> bool:
        """Whether a stray at this place is a phantom."""
        return self.origin_of(place_mm).kind is Origin.PHANTOM

    def is_reflection(self, place_mm: Sequence[float]) -> bool:
        """Whether a stray at this place is a reflection."""
        return self.origin_of(place_mm).kind is Origin.REFLECTION


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

    def place_sphere(self, at_mm: Sequence[float], frame: Frame | str = "tracker") -> str:
        """Place one more sphere in the room, at a place in the tracker's frame or the robot's.

        The tracker sees it, the cameras do not. It rests there until `clear` ends the line that is returned.
        Raises ARG-001 for another frame.
        """
        place = require_numbers(at_mm, "the place of the sphere", shape=(3,))
        if frame not in (Frame.TRACKER, Frame.ROBOT):
            raise WrongArgument(
                "a sphere is placed in another frame", expected="tracker or robot", got=show(str(frame))
            )
        if frame == Frame.TRACKER:
            place = self.truth().robot_from_tracker.apply(place)
        line = f"room extra sphere {_numbers(place.tolist())} mm"
        self.inject(line)
        return line

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
                    int(one["number"]),
                    vector3(one["tracker_mm"]),
                    bool(one["seen"]),
                    bool(one["in_volume"]),
                    str(one["because"]),
                )
                for one in told["spheres"]
            ),
            tuple(TrueMarker(str(one["name"]), vector3(one["tracker_mm"])) for one in told["others"]),
            tuple(
                TruePhantom((str(one["of"][0]), str(one["of"][1])), vector3(one["tracker_mm"]))
                for one in told["phantoms"]
            ),
            np.array(told["reflections_mm"], dtype=float).reshape(-1, 3),
            Transform.from_matrix(Frame.ROBOT, Frame.TRACKER, np.array(told["robot_from_tracker"])),
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
