"""Truth of a simulated theatre's room: where everything is, and what a stray of the tracker comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arguments import WrongArgument, require_numbers, show
from ronna_hw.frames import Frame, Transform
from ronna_hw.notebook_html import table_html
from ronna_hw.vectors import JointVector, Vector3, vector3

SPHERE = "sphere "  # followed by its number
IN_VIEW = "in view"  # of a marker that the tracker sees


@dataclass(frozen=True)
class TrueSphere:
    """True position and visibility of a sphere on the head.

    `seen` is true for one outside the measuring volume too, which is reported as a stray on request.
    `in_volume` judges the unit's first volume, even if a driver has selected another.
    """

    number: int
    tracker_mm: Vector3
    seen: bool
    in_volume: bool
    because: str

    @property
    def name(self) -> str:
        """Name of the sphere by its number."""
        return f"{SPHERE}{self.number}"


@dataclass(frozen=True)
class TrueMarker:
    """Another marker in the room, such as one of a tool: its name, where it is, and whether it is seen."""

    name: str
    tracker_mm: Vector3
    seen: bool
    because: str


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


@dataclass(frozen=True, repr=False)
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
        """Return the sphere nearest to a place in the tracker frame, as of a stray. Raises ARG-001."""
        place = require_vector(place_mm, "stray")
        if not self.spheres:
            raise WrongArgument("this room has no spheres", expected="a scene with a head")
        return min(self.spheres, key=lambda one: float(np.linalg.norm(np.subtract(one.tracker_mm, place))))

    def origin_of(self, place_mm: Sequence[float]) -> StrayOrigin:
        """Return what a stray at a place comes from: whatever is nearest.

        Raises ARG-001 for no place, and in an empty room.
        """
        place = require_vector(place_mm, "stray")
        candidates = [
            *((Origin.SPHERE, one.name, one.tracker_mm) for one in self.spheres),
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

    def __repr__(self) -> str:
        unseen = [f"{one.name} ({one.because})" for one in self.spheres if not one.seen]
        phantoms, reflections = len(self.phantoms), len(self.reflections_mm)
        parts = [
            f"{len(self.spheres)} spheres, {len(self.spheres) - len(unseen)} seen",
            *([f"not {', '.join(unseen)}"] if unseen else []),
            f"{len(self.others)} other markers",
            f"{phantoms} phantoms",
            f"{reflections} reflections",
            *self.disturbances,
        ]
        return f"<RoomTruth at {self.theatre_time_s:.3f} s: {'; '.join(parts)}>"

    def _repr_html_(self) -> str:
        """Return all places as a table, as a notebook shows it."""
        rows = [*self._list_rows()]
        return table_html(("name", "kind", "tracker_mm", "sight"), rows, len(rows), repr(self))

    def _list_rows(self) -> Iterator[tuple[str, str, NDArray[np.float64], str]]:
        for sphere in self.spheres:
            yield sphere.name, Origin.SPHERE, np.array(sphere.tracker_mm), sphere.because
        for other in self.others:
            yield other.name, Origin.OTHER, np.array(other.tracker_mm), other.because
        for phantom in self.phantoms:
            yield phantom.name, Origin.PHANTOM, np.array(phantom.tracker_mm), ""
        for number, place_mm in enumerate(self.reflections_mm, 1):
            yield f"reflection {number}", Origin.REFLECTION, place_mm, ""


def require_vector(given: object, of: str, unit: str = "mm") -> NDArray[np.float64]:
    """Return the coordinates (3,) of something. Raises ARG-001 for anything but three finite numbers."""
    place = require_numbers(given, f"the coordinates of the {of}", shape=(3,))
    if not np.isfinite(place).all():
        raise WrongArgument(
            f"the coordinates of the {of} are not finite", expected=f"x, y, z in {unit}", got=show(given)
        )
    return place


def read_truth(told: Mapping[str, Any]) -> RoomTruth:
    """Read the truth as the control port tells it."""
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
        tuple(
            TrueMarker(str(one["name"]), vector3(one["tracker_mm"]), bool(one["seen"]), str(one["because"]))
            for one in told["others"]
        ),
        tuple(
            TruePhantom((str(one["of"][0]), str(one["of"][1])), vector3(one["tracker_mm"]))
            for one in told["phantoms"]
        ),
        np.array(told["reflections_mm"], dtype=float).reshape(-1, 3),
        Transform.from_matrix(Frame.ROBOT, Frame.TRACKER, np.array(told["robot_from_tracker"])),
        tuple(map(str, told["disturbances"])),
    )
