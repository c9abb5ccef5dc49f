"""Marker-sized objects of the same polymer that are not whole spheres.

Each function draws one object next to the head or on the skin, with the points at which a localizer may
mistake it for a sphere: these are painted as precisely as markers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim.phantom.head.anatomy import AIR_HU, METAL_HU
from sim.phantom.head.shapes import Ball, Barrel, Dome, Egg, HeadCapsule, Ring, Rod, Shape
from sim.world.rigid import Point, Vector, as_rounded_point

RADIUS_MM = 5.75  # of the usual marker, which look-alikes resemble
POLYMER_HU = (80.0, 200.0)
GEL_HU = (-20.0, 60.0)
STANDOFF_MM = (22.0, 32.0)
STEEPEST = 0.5  # slope of a body's own direction towards the skin, so that it does not run into the head


@dataclass(frozen=True)
class LookAlike:
    """A look-alike: its kind, bodies in painting order, and points that could deceive a localizer."""

    kind: str
    shapes: tuple[Shape, ...]
    places: tuple[Point, ...]


@dataclass(frozen=True)
class PlacedOn:
    """Placement of an object: a skin point, its outward normal and a generator for further draws."""

    skin: Vector
    normal: Vector
    random: np.random.Generator

    def between(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def polymer(self) -> float:
        return self.between(*POLYMER_HU)

    def middle(self) -> Vector:
        """Pick a random centre next to the head."""
        return np.asarray(self.skin + self.normal * self.between(*STANDOFF_MM))

    def along(self) -> Vector:
        """Draw a direction that does not lead into the head."""
        along = self.random.standard_normal(3)
        along -= (along @ self.normal) * self.normal
        along = along / np.linalg.norm(along) + self.between(-STEEPEST, STEEPEST) * self.normal
        return np.asarray(along / np.linalg.norm(along))

    def axes(self) -> tuple[Point, Point, Point]:
        """Draw three perpendicular directions."""
        turned, _ = np.linalg.qr(self.random.standard_normal((3, 3)))
        first, second, third = (as_rounded_point(row) for row in turned)
        return first, second, third


Draw = Callable[[PlacedOn], LookAlike]


def _make_look_alike(kind: str, shapes: Sequence[Shape], *places: Vector) -> LookAlike:
    return LookAlike(kind, tuple(shapes), tuple(as_rounded_point(place) for place in places))


def _ball(hu: float, centre: Vector, radius: float) -> Ball:
    return Ball(hu, as_rounded_point(centre), radius)


def _rod(hu: float, start: Vector, along: Vector, length: float, radius: float) -> Rod:
    return Rod(hu, as_rounded_point(start), as_rounded_point(along), length, radius)


def _capsule(hu: float, start: Vector, end: Vector, radius: float) -> HeadCapsule:
    return HeadCapsule(hu, as_rounded_point(start), as_rounded_point(end), radius)


def _dome(hu: float, centre: Vector, outward: Vector, radius: float, height: float) -> Dome:
    return Dome(hu, as_rounded_point(centre), as_rounded_point(outward), radius, height)


def _egg(seat: PlacedOn, hu: float, centre: Vector, *semi_axes: float) -> Egg:
    """Create a randomly oriented ellipsoid."""
    a, b, c = semi_axes
    return Egg(hu, as_rounded_point(centre), (a, b, c), seat.axes())


def capsule(seat: PlacedOn) -> LookAlike:
    """Return a round-ended rod 2 to 24 mm longer than it is wide."""
    middle, along = seat.middle(), seat.along()
    half = 0.5 * along * seat.between(2.0, 24.0)
    body = _capsule(seat.polymer(), middle - half, middle + half, seat.between(5.5, 6.0))
    return _make_look_alike("capsule", [body], middle - half, middle, middle + half)


def round_ended_rod(seat: PlacedOn) -> LookAlike:
    """Return a rod with one round end and one flat end."""
    end, along = seat.middle(), seat.along()
    radius, hu = seat.between(5.4, 6.1), seat.polymer()
    rod = _rod(hu, end, along, seat.between(12.0, 30.0), radius)
    return _make_look_alike("round-ended rod", [_ball(hu, end, radius), rod], end)


def egg(seat: PlacedOn) -> LookAlike:
    """Return an ellipsoid a quarter to a seventh longer than wide."""
    middle, longer = seat.middle(), seat.between(0.07, 0.2)
    sizes = (RADIUS_MM * (1.0 - longer), RADIUS_MM, RADIUS_MM * (1.0 + longer))
    return _make_look_alike("egg", [_egg(seat, seat.polymer(), middle, *sizes)], middle)


def beads(seat: PlacedOn) -> LookAlike:
    """Return a string of three to five marker-sized balls."""
    count, spacing = int(seat.random.integers(3, 6)), seat.between(9.0, 11.4)
    first, along, hu = seat.middle(), seat.along(), seat.polymer()
    radius = seat.between(5.6, 5.9)
    places = [first + along * spacing * (k - 0.5 * (count - 1)) for k in range(count)]
    string = _rod(hu, places[0], along, spacing * (count - 1), seat.between(0.5, 1.0))
    return _make_look_alike("beads", [string, *(_ball(hu, place, radius) for place in places)], *places)


def knob(seat: PlacedOn) -> LookAlike:
    """Return a ball at the end of a rod that is much thicker than a post."""
    middle, along, hu = seat.middle(), seat.along(), seat.polymer()
    rod = _rod(hu, middle, along, seat.between(16.0, 26.0), seat.between(3.6, 5.0))
    return _make_look_alike("knob", [rod, _ball(hu, middle, seat.between(5.6, 5.9))], middle)


def elbow(seat: PlacedOn) -> LookAlike:
    """Return two rods joined by a round elbow."""
    joint, hu, radius = seat.middle(), seat.polymer(), seat.between(5.5, 6.0)
    arm_directions = seat.along(), seat.along()
    ends = [joint + arm_direction * seat.between(8.0, 22.0) for arm_direction in arm_directions]
    return _make_look_alike("elbow", [_capsule(hu, joint, end, radius) for end in ends], joint, *ends)


def thumb(seat: PlacedOn) -> LookAlike:
    """Return a rod tapering towards its round end."""
    end, along, hu = seat.middle(), seat.along(), seat.polymer()
    radius, opening = seat.between(5.3, 5.9), seat.between(0.05, 0.25)
    steps = np.arange(0.0, 16.0, 1.0)
    balls = [_ball(hu, end + along * step, radius + opening * step) for step in steps]
    return _make_look_alike("thumb", balls, end)


def dome(seat: PlacedOn) -> LookAlike:
    """Return roughly half a ball on the skin."""
    centre = seat.skin + seat.normal * seat.between(-0.5, 2.0)
    radius = seat.between(5.6, 6.0)
    ball = _dome(seat.polymer(), centre, seat.normal, radius, -seat.between(0.0, 2.0))
    return _make_look_alike("dome", [ball], centre)


def mushroom(seat: PlacedOn) -> LookAlike:
    """Return a flat-bottomed cap on a stem, two thirds to nine tenths of a ball in height."""
    middle, hu = seat.middle(), seat.polymer()
    cap = _dome(hu, middle, seat.normal, RADIUS_MM, -RADIUS_MM * seat.between(0.3, 0.75))
    stem = _rod(METAL_HU, middle + 2.5 * -seat.normal, -seat.normal, 24.0, 1.5)
    return _make_look_alike("mushroom", [cap, stem], middle)


def barrel(seat: PlacedOn) -> LookAlike:
    """Return a cylinder as tall as it is wide, with rounded edges."""
    middle, radius = seat.middle(), seat.between(5.2, 5.9)
    hu, along = seat.polymer(), as_rounded_point(seat.along())
    length, edge = seat.between(10.5, 12.5), seat.between(2.0, 4.2)
    return _make_look_alike(
        "barrel", [Barrel(hu, as_rounded_point(middle), along, length, radius, edge)], middle
    )


def button(seat: PlacedOn) -> LookAlike:
    """Return a lens-shaped ellipsoid, flattened by a fifth to a half."""
    middle, width = seat.middle(), seat.between(5.75, 6.6)
    sizes = (width, width, width * seat.between(0.5, 0.8))
    return _make_look_alike("button", [_egg(seat, seat.polymer(), middle, *sizes)], middle)


def hollow_ball(seat: PlacedOn) -> LookAlike:
    """Return a marker-sized hollow ball filled with air."""
    middle = seat.middle()
    core = _ball(AIR_HU, middle, RADIUS_MM - seat.between(1.2, 3.0))
    return _make_look_alike("hollow ball", [_ball(seat.polymer(), middle, RADIUS_MM), core], middle)


def other_ball(seat: PlacedOn) -> LookAlike:
    """Return a whole ball 9.5 to 10.6 mm or 12.5 to 14 mm in diameter."""
    middle = seat.middle()
    small = bool(seat.random.uniform() < 0.5)
    radius = seat.between(4.75, 5.3) if small else seat.between(6.25, 7.0)
    return _make_look_alike("other ball", [_ball(seat.polymer(), middle, radius)], middle)


def near_ball(seat: PlacedOn) -> LookAlike:
    """Return a whole ball 10.6 to 11.2 mm in diameter, closer to marker size than `other_ball`."""
    middle = seat.middle()
    return _make_look_alike("near ball", [_ball(seat.polymer(), middle, seat.between(5.3, 5.6))], middle)


def gel(seat: PlacedOn) -> LookAlike:
    """Return a drop of gel containing air bubbles."""
    middle, hu = seat.middle(), seat.between(*GEL_HU)
    bubbles = []
    for _ in range(int(seat.random.integers(2, 5))):
        arm_direction = seat.random.standard_normal(3)
        place = middle + arm_direction / np.linalg.norm(arm_direction) * seat.between(1.5, 5.0)
        bubbles.append(_ball(AIR_HU, place, seat.between(1.5, 3.0)))
    return _make_look_alike("gel with bubbles", [_ball(hu, middle, seat.between(5.6, 6.6)), *bubbles], middle)


def ring(seat: PlacedOn) -> LookAlike:
    """Return a thick ring."""
    middle, tube = seat.middle(), seat.between(2.4, 3.2)
    body = Ring(seat.polymer(), as_rounded_point(middle), seat.axes()[0], seat.between(2.6, 3.4), tube)
    return _make_look_alike("ring", [body], middle)


def acrylic_teeth(seat: PlacedOn) -> LookAlike:
    """Return three artificial teeth in a row."""
    middle, along, hu = seat.middle(), seat.along(), seat.polymer()
    places = [middle + along * 9.0 * k for k in (-1, 0, 1)]
    sizes = ((4.6, 5.4), (5.0, 5.8), (5.6, 7.0))
    bodies = [_egg(seat, hu, place, *(seat.between(*size) for size in sizes)) for place in places]
    return _make_look_alike("acrylic teeth", bodies, *places)


def pearl(seat: PlacedOn) -> LookAlike:
    """Return a polymer ball with a metal core."""
    middle = seat.middle()
    core = _ball(METAL_HU, middle, seat.between(1.0, 2.2))
    return _make_look_alike("pearl", [_ball(seat.polymer(), middle, RADIUS_MM), core], middle)


def threaded_ball(seat: PlacedOn) -> LookAlike:
    """Return a ball with a pin right through it."""
    middle, along = seat.middle(), seat.along()
    pin = _rod(METAL_HU, middle - 12.0 * along, along, 24.0, seat.between(0.8, 1.6))
    return _make_look_alike("threaded ball", [_ball(seat.polymer(), middle, RADIUS_MM), pin], middle)


def plated_dome(seat: PlacedOn) -> LookAlike:
    """Return slightly more than half a ball, on a plate."""
    middle, hu, inward = seat.middle(), seat.polymer(), -seat.normal
    below = seat.between(0.0, 3.5)
    cap = _dome(hu, middle, seat.normal, RADIUS_MM, -below)
    plate = _rod(hu, middle + below * inward, inward, seat.between(1.5, 3.0), seat.between(6.5, 10.0))
    return _make_look_alike("plated dome", [cap, plate], middle)


def peanut(seat: PlacedOn) -> LookAlike:
    """Return two balls fused together."""
    middle, along, hu = seat.middle(), seat.along(), seat.polymer()
    apart = along * seat.between(1.5, 5.0)
    balls = [_ball(hu, middle, seat.between(5.5, 5.9)), _ball(hu, middle + apart, seat.between(4.5, 5.9))]
    return _make_look_alike("peanut", balls, middle, middle + 0.5 * apart)


def cup_electrode(seat: PlacedOn) -> LookAlike:
    """Return a polymer dome over a metal disc on the skin."""
    centre = seat.skin + seat.normal * seat.between(1.5, 3.0)
    cap = _dome(seat.polymer(), centre, seat.normal, seat.between(5.6, 6.0), 0.0)
    disc = _rod(METAL_HU, centre - 1.5 * seat.normal, seat.normal, 1.5, seat.between(3.0, 5.0))
    return _make_look_alike("cup electrode", [disc, cap], centre)


ROUNDED: tuple[Draw, ...] = (capsule, round_ended_rod, egg)
SIZES: tuple[Draw, ...] = (near_ball,)
JOINED: tuple[Draw, ...] = (beads, knob)
ENDS: tuple[Draw, ...] = (elbow, thumb, round_ended_rod)
CAPS: tuple[Draw, ...] = (dome, mushroom, barrel, button)
HOLLOW: tuple[Draw, ...] = (hollow_ball, other_ball, gel, ring)
PLATES: tuple[Draw, ...] = (plated_dome, peanut, cup_electrode)
FITTINGS: tuple[Draw, ...] = (acrylic_teeth, pearl, threaded_ball)
