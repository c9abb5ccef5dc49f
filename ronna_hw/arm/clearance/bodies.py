"""All bodies that can collide: the links of an arm, its tool, and its surroundings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from ronna_hw.arm.clearance.capsule import Capsule
from ronna_hw.arm.clearance.surroundings import Surroundings
from ronna_hw.arm.links import COLUMN_NAME, ArmBodies, ArmPart


class Pair(NamedTuple):
    """Two bodies that must keep their distance: index of the moving one, and of the other.

    A non-negative `other` is the index of a fixed body; -1 - k is the moving body k.
    """

    moving: int
    other: int
    enters_head: bool
    is_head: bool


@dataclass(frozen=True)
class Bodies:
    """Moving bodies: the arm's links, then parts of the tool. Fixed ones: its column, then obstacles."""

    arm: ArmBodies
    surroundings: Surroundings

    def names(self, pair: Pair) -> tuple[str, str]:
        """Names of the two bodies of a pair."""
        if pair.other < 0:
            other = self.moving_names[-1 - pair.other]
        elif pair.other == 0:
            other = COLUMN_NAME
        else:
            other = self.surroundings.obstacles[pair.other - 1].name
        return self.moving_names[pair.moving], other

    @cached_property
    def moving_names(self) -> tuple[str, ...]:
        """Names of the moving bodies."""
        return (
            *(link.name for link in self.arm.links),
            *(part.name for part in self.surroundings.tool),
        )

    @cached_property
    def moving_radii_mm(self) -> tuple[float, ...]:
        """Radii of the moving bodies."""
        radii = self.surroundings.radii
        return (
            *(radii.of(link.part) for link in self.arm.links),
            *(part.capsule.radius_mm for part in self.surroundings.tool),
        )

    @cached_property
    def fixed(self) -> tuple[Capsule, ...]:
        """The fixed bodies; the column extends from the base to slightly below the first moving one."""
        radius_mm = self.surroundings.radii.of(ArmPart.COLUMN)
        top_mm = max(self.arm.column_height_mm - radius_mm, 0.0)
        column = Capsule((0.0, 0.0, 0.0), (0.0, 0.0, top_mm), radius_mm)
        return (column, *(obstacle.capsule for obstacle in self.surroundings.obstacles))

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """Every pair that can collide. Bodies that touch by construction are left out."""
        links, tool = self.arm.links, self.surroundings.tool
        obstacles = self.surroundings.obstacles
        count = len(links)
        touches = (*(link.touches for link in links), *((links[-1].name,) for _ in tool))
        enters = (*(False,) * count, *(part.enters_head for part in tool))
        found = []
        for moving, touched in enumerate(touches):
            if COLUMN_NAME not in touched:
                found.append(Pair(moving, 0, enters[moving], False))
            found += [
                Pair(moving, number, enters[moving], obstacle.is_head)
                for number, obstacle in enumerate(obstacles, start=1)
            ]
        for inner, link in enumerate(links):
            found += [
                Pair(moving, -1 - inner, False, False)
                for moving in range(inner + 1, len(touches))
                if link.name not in touches[moving]
            ]
        return tuple(found)
