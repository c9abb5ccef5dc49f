"""Objects in the scene, built from the few shapes of the page library."""

from __future__ import annotations

import math
from typing import Any

from console.scene.bodies import METRES, Point, Rows, upright
from procedures.engine.events import Body

ROUND = 16  # segments around a capsule
Call = list[Any]  # to a method of the scene, with its arguments


class Capsule:
    """A body between two points; its length never changes, so only its pose is sent."""

    def __init__(self, scene: Any, body: Body, start: Point, end: Point, colour: str, opacity: float) -> None:
        length, radius = math.dist(start, end) * METRES, body.radius_mm * METRES
        with scene.group() as self.group:
            scene.cylinder(radius, radius, length, ROUND).rotate(math.pi / 2.0, 0, 0).move(
                0, 0, length / 2.0
            ).material(colour, opacity)
            for z in (0.0, length):
                scene.sphere(radius, ROUND, ROUND // 2).move(0, 0, z).material(colour, opacity)
        self.group.with_name(body.name)
        self.place(start, end)

    def place(self, start: Point, end: Point) -> list[Call]:
        """Store its pose; returns the calls that place it on an open page."""
        return placed(self.group, start, upright(start, end))

    def delete(self) -> None:
        """Remove it."""
        self.group.delete()


class Rod:
    """A thin line between two points that may both move."""

    def __init__(self, scene: Any, radius_mm: float, colour: str) -> None:
        radius = radius_mm * METRES
        with scene.group() as self.group:
            scene.cylinder(radius, radius, 1.0, 8).rotate(math.pi / 2.0, 0, 0).move(0, 0, 0.5).material(
                colour
            )
        self.group.visible(False)

    def place(self, start: Point, end: Point) -> list[Call]:
        """Like `Capsule.place`."""
        length = max(math.dist(start, end) * METRES, 1e-6)
        self.group.sx, self.group.sy, self.group.sz = 1.0, 1.0, length
        self.group.visible_ = True
        scaled = ["scale", self.group.id, 1.0, 1.0, length]
        return [*placed(self.group, start, upright(start, end)), scaled, ["visible", self.group.id, True]]


def placed(thing: Any, at_mm: Point, rotation: Rows) -> list[Call]:
    """Store a pose for pages opened later, and return the calls that apply it on an open one."""
    thing.x, thing.y, thing.z = (value * METRES for value in at_mm)
    thing.R = rotation
    return [["move", thing.id, thing.x, thing.y, thing.z], ["rotate", thing.id, rotation]]
