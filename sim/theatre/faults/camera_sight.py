"""Faults of what the cameras see: blood, glare, an obstruction, a camera twisted in its mount."""

from __future__ import annotations

from collections.abc import Iterator

from sim.theatre.faults.kinds import Arguments, FaultKind
from sim.theatre.scene.model import Scene

SIDES = ("left", "right")
MOST_STAINED_PERCENT = 60.0  # spots overlap: far more would take long and look no different
WHOLE_PERCENT = 100.0


def _side(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if arguments[0] not in SIDES:
        yield f"there is no camera {arguments[0]!r}, only {' and '.join(SIDES)}"


def _side_and_share(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from _side(arguments, scene)
    if float(arguments[1]) > WHOLE_PERCENT:
        yield f"{arguments[1]} % is more than 100 %"


def _stain(arguments: Arguments, scene: Scene) -> Iterator[str]:
    numbers = [fiducial.number for fiducial in scene.head.fiducials]
    if int(arguments[0]) not in numbers:
        yield f"there is no marker {arguments[0]}, only {', '.join(map(str, numbers))}"
    if float(arguments[1]) > MOST_STAINED_PERCENT:
        yield f"{arguments[1]} % is more than the {MOST_STAINED_PERCENT:g} % that can be drawn"


SIGHT_FAULTS = (
    FaultKind(
        "stain",
        "camera",
        "stain marker INT NUMBER %",
        "Spots of blood cover that share of a fiducial's film.",
        check=_stain,
    ),
    FaultKind(
        "glare",
        "camera",
        "glare NAME NUMBER px",
        "A lamp reflects into the image of the left or right camera, with that radius.",
        check=_side,
    ),
    FaultKind(
        "occluder",
        "camera",
        "occlude NAME NUMBER %",
        "A straight edge hides that share of the sphere's rim from the left or right camera.",
        check=_side_and_share,
    ),
    FaultKind(
        "twist",
        "camera",
        "twist NAME SIGNED deg",
        "The left or right camera turns by that angle in its mount, in the plane of both.",
        check=_side,
    ),
    FaultKind(
        "creep",
        "camera",
        "creep NAME SIGNED deg per min",
        "The left or right camera keeps turning in its mount at that rate, in the plane of both.",
        check=_side,
    ),
)
