"""Objects of the markers' polymer and about their size that are not whole spheres.

Each function draws one object next to the head or on the skin, with the points at which a localizer may
mistake it for a sphere: these are painted as precisely as markers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.anatomy import AIR_HU, METAL_HU
from sim.phantom.head.shapes import Ball, Barrel, Capsule, Dome, Egg, Point, Ring, Rod, Shape, rounded_point

Vector = NDArray[np.float64]

RADIUS_MM = 5.75  # of the usual marker, which look-alikes resemble
POLYMER_HU = (80.0, 200.0)
GEL_HU = (-20.0, 60.0)
STANDOFF_MM = (22.0, 32.0)
STEEPEST = 0.5  # slope of a body's own direction towards the skin, so that it does not run into the head


@dataclass(frozen=True)
class LookAlike:
    """Kind of the object, its bodies in painting order, and the points that may deceive a localizer."""

    kind: str
    shapes: tuple[Shape, ...]
    places: tuple[Point, ...]


@dataclass(frozen=True)
class Seat:
    """Place of an object: a point on the skin, the outward normal there, and the generator for the rest."""

    skin: Vector
    normal: Vector
    random: np.random.Generator

    def between(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def polymer(self) -> float:
        return self.between(*POLYMER_HU)

    def middle(self) -> Vector:
        """Draw a point next to the head."""
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
        first, second, third = (rounded_point(row) for row in turned)
        return first, second, third


Draw = Callable[[Seat], LookAlike]


def capsule(seat: Seat) -> LookAlike:
    """A rod round at both ends, 2 to 24 mm longer than wide."""
    middle, along = seat.middle(), seat.along()
    half = 0.5 * along * seat.between(2.0, 24.0)
    body = Capsule(
        seat.polymer(), rounded_point(middle - half), rounded_point(middle + half), seat.between(5.5, 6.0)
    )
    return LookAlike(
        "capsule",
        (body,),
        (rounded_point(middle - half), rounded_point(middle), rounded_point(middle + half)),
    )


def round_ended_rod(seat: Seat) -> LookAlike:
    """A rod with one end round, the other flat."""
    end, along = seat.middle(), seat.along()
    radius, hu = seat.between(5.4, 6.1), seat.polymer()
    rod = Rod(hu, rounded_point(end), rounded_point(along), seat.between(12.0, 30.0), radius)
    return LookAlike("round-ended rod", (Ball(hu, rounded_point(end), radius), rod), (rounded_point(end),))


def egg(seat: Seat) -> LookAlike:
    """An ellipsoid a quarter to a seventh longer than wide."""
    middle = rounded_point(seat.middle())
    longer = seat.between(0.07, 0.2)
    semi_axes = (RADIUS_MM * (1.0 - longer), RADIUS_MM, RADIUS_MM * (1.0 + longer))
    return LookAlike("egg", (Egg(seat.polymer(), middle, semi_axes, seat.axes()),), (middle,))


def beads(seat: Seat) -> LookAlike:
    """Three to five balls of a marker's size in a row, on a string."""
    count, spacing = int(seat.random.integers(3, 6)), seat.between(9.0, 11.4)
    first, along, hu = seat.middle(), seat.along(), seat.polymer()
    radius = seat.between(5.6, 5.9)
    places = [rounded_point(first + along * spacing * (k - 0.5 * (count - 1))) for k in range(count)]
    string = Rod(hu, places[0], rounded_point(along), spacing * (count - 1), seat.between(0.5, 1.0))
    return LookAlike("beads", (string, *(Ball(hu, place, radius) for place in places)), tuple(places))


def knob(seat: Seat) -> LookAlike:
    """A ball at the end of a rod that is much thicker than a post."""
    middle, along, hu = seat.middle(), seat.along(), seat.polymer()
    rod = Rod(
        hu, rounded_point(middle), rounded_point(along), seat.between(16.0, 26.0), seat.between(3.6, 5.0)
    )
    ball = Ball(hu, rounded_point(middle), seat.between(5.6, 5.9))
    return LookAlike("knob", (rod, ball), (rounded_point(middle),))


def elbow(seat: Seat) -> LookAlike:
    """Two rods that meet in a round joint."""
    joint, hu, radius = seat.middle(), seat.polymer(), seat.between(5.5, 6.0)
    one, other = seat.along(), seat.along()
    arms = tuple(
        Capsule(hu, rounded_point(joint), rounded_point(joint + way * seat.between(8.0, 22.0)), radius)
        for way in (one, other)
    )
    return LookAlike("elbow", arms, (rounded_point(joint), *(arm.end for arm in arms)))


def thumb(seat: Seat) -> LookAlike:
    """A rod that narrows towards its round end."""
    end, along, hu = seat.middle(), seat.along(), seat.polymer()
    radius, opening = seat.between(5.3, 5.9), seat.between(0.05, 0.25)
    balls = [
        Ball(hu, rounded_point(end + along * step), radius + opening * step)
        for step in np.arange(0.0, 16.0, 1.0)
    ]
    return LookAlike("thumb", tuple(balls), (rounded_point(end),))


def dome(seat: Seat) -> LookAlike:
    """Half a ball on the skin, a little more or less."""
    centre = seat.skin + seat.normal * seat.between(-0.5, 2.0)
    radius = seat.between(5.6, 6.0)
    ball = Dome(
        seat.polymer(), rounded_point(centre), rounded_point(seat.normal), radius, -seat.between(0.0, 2.0)
    )
    return LookAlike("dome", (ball,), (rounded_point(centre),))


def mushroom(seat: Seat) -> LookAlike:
    """A cap on a stem: two thirds to nine tenths of a ball's height, flat below."""
    middle, hu = seat.middle(), seat.polymer()
    inward = -seat.normal
    cap = Dome(
        hu, rounded_point(middle), rounded_point(seat.normal), RADIUS_MM, -RADIUS_MM * seat.between(0.3, 0.75)
    )
    stem = Rod(METAL_HU, rounded_point(middle + 2.5 * inward), rounded_point(inward), 24.0, 1.5)
    return LookAlike("mushroom", (cap, stem), (rounded_point(middle),))


def barrel(seat: Seat) -> LookAlike:
    """A cylinder as high as wide, with rounded edges."""
    middle = rounded_point(seat.middle())
    radius = seat.between(5.2, 5.9)
    body = Barrel(
        seat.polymer(),
        middle,
        rounded_point(seat.along()),
        seat.between(10.5, 12.5),
        radius,
        seat.between(2.0, 4.2),
    )
    return LookAlike("barrel", (body,), (middle,))


def button(seat: Seat) -> LookAlike:
    """A lens: an ellipsoid flattened by a fifth to a half."""
    middle = rounded_point(seat.middle())
    width = seat.between(5.75, 6.6)
    semi_axes = (width, width, width * seat.between(0.5, 0.8))
    return LookAlike("button", (Egg(seat.polymer(), middle, semi_axes, seat.axes()),), (middle,))


def hollow_ball(seat: Seat) -> LookAlike:
    """A ball of a marker's size with air inside."""
    middle = rounded_point(seat.middle())
    core = Ball(AIR_HU, middle, RADIUS_MM - seat.between(1.2, 3.0))
    return LookAlike("hollow ball", (Ball(seat.polymer(), middle, RADIUS_MM), core), (middle,))


def other_ball(seat: Seat) -> LookAlike:
    """A whole ball with a diameter of 9.5 to 10.6, or of 12.5 to 14 mm."""
    middle = rounded_point(seat.middle())
    small = bool(seat.random.uniform() < 0.5)
    radius = seat.between(4.75, 5.3) if small else seat.between(6.25, 7.0)
    return LookAlike("other ball", (Ball(seat.polymer(), middle, radius),), (middle,))


def near_ball(seat: Seat) -> LookAlike:
    """A whole ball with a diameter of 10.6 to 11.2 mm: nearer to a marker's than other balls."""
    middle = rounded_point(seat.middle())
    return LookAlike("near ball", (Ball(seat.polymer(), middle, seat.between(5.3, 5.6)),), (middle,))


def gel(seat: Seat) -> LookAlike:
    """A drop of gel with air bubbles."""
    middle, hu = seat.middle(), seat.between(*GEL_HU)
    bubbles = []
    for _ in range(int(seat.random.integers(2, 5))):
        way = seat.random.standard_normal(3)
        place = middle + way / np.linalg.norm(way) * seat.between(1.5, 5.0)
        bubbles.append(Ball(AIR_HU, rounded_point(place), seat.between(1.5, 3.0)))
    return LookAlike(
        "gel with bubbles",
        (Ball(hu, rounded_point(middle), seat.between(5.6, 6.6)), *bubbles),
        (rounded_point(middle),),
    )


def ring(seat: Seat) -> LookAlike:
    """A thick ring."""
    middle = rounded_point(seat.middle())
    tube = seat.between(2.4, 3.2)
    body = Ring(seat.polymer(), middle, seat.axes()[0], seat.between(2.6, 3.4), tube)
    return LookAlike("ring", (body,), (middle,))


def acrylic_teeth(seat: Seat) -> LookAlike:
    """Three artificial teeth in a row."""
    middle, along, hu = seat.middle(), seat.along(), seat.polymer()
    places = [rounded_point(middle + along * 9.0 * k) for k in (-1, 0, 1)]
    bodies = tuple(
        Egg(hu, place, (seat.between(4.6, 5.4), seat.between(5.0, 5.8), seat.between(5.6, 7.0)), seat.axes())
        for place in places
    )
    return LookAlike("acrylic teeth", bodies, tuple(places))


def pearl(seat: Seat) -> LookAlike:
    """A ball of polymer around a metal core."""
    middle = rounded_point(seat.middle())
    core = Ball(METAL_HU, middle, seat.between(1.0, 2.2))
    return LookAlike("pearl", (Ball(seat.polymer(), middle, RADIUS_MM), core), (middle,))


def threaded_ball(seat: Seat) -> LookAlike:
    """A ball with a pin all the way through it."""
    middle, along = seat.middle(), seat.along()
    pin = Rod(
        METAL_HU, rounded_point(middle - 12.0 * along), rounded_point(along), 24.0, seat.between(0.8, 1.6)
    )
    return LookAlike(
        "threaded ball",
        (Ball(seat.polymer(), rounded_point(middle), RADIUS_MM), pin),
        (rounded_point(middle),),
    )


def plated_dome(seat: Seat) -> LookAlike:
    """Half a ball and more on a plate."""
    middle, hu = seat.middle(), seat.polymer()
    inward = -seat.normal
    below = seat.between(0.0, 3.5)
    cap = Dome(hu, rounded_point(middle), rounded_point(seat.normal), RADIUS_MM, -below)
    plate = Rod(
        hu,
        rounded_point(middle + below * inward),
        rounded_point(inward),
        seat.between(1.5, 3.0),
        seat.between(6.5, 10.0),
    )
    return LookAlike("plated dome", (cap, plate), (rounded_point(middle),))


def peanut(seat: Seat) -> LookAlike:
    """Two balls fused into one."""
    middle, along, hu = seat.middle(), seat.along(), seat.polymer()
    apart = along * seat.between(1.5, 5.0)
    balls = (
        Ball(hu, rounded_point(middle), seat.between(5.5, 5.9)),
        Ball(hu, rounded_point(middle + apart), seat.between(4.5, 5.9)),
    )
    return LookAlike("peanut", balls, (rounded_point(middle), rounded_point(middle + 0.5 * apart)))


def cup_electrode(seat: Seat) -> LookAlike:
    """A dome of polymer over a metal disc on the skin."""
    centre = seat.skin + seat.normal * seat.between(1.5, 3.0)
    cap = Dome(seat.polymer(), rounded_point(centre), rounded_point(seat.normal), seat.between(5.6, 6.0), 0.0)
    start = rounded_point(centre - 1.5 * seat.normal)
    disc = Rod(METAL_HU, start, rounded_point(seat.normal), 1.5, seat.between(3.0, 5.0))
    return LookAlike("cup electrode", (disc, cap), (rounded_point(centre),))


ROUNDED: tuple[Draw, ...] = (capsule, round_ended_rod, egg)
SIZES: tuple[Draw, ...] = (near_ball,)
JOINED: tuple[Draw, ...] = (beads, knob)
ENDS: tuple[Draw, ...] = (elbow, thumb, round_ended_rod)
CAPS: tuple[Draw, ...] = (dome, mushroom, barrel, button)
HOLLOW: tuple[Draw, ...] = (hollow_ball, other_ball, gel, ring)
PLATES: tuple[Draw, ...] = (plated_dome, peanut, cup_electrode)
FITTINGS: tuple[Draw, ...] = (acrylic_teeth, pearl, threaded_ball)
