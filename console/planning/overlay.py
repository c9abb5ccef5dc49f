"""What is drawn over an image: crosshair, spheres, trajectories and the patient's sides."""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from console.panels.html import tag, text
from console.pictures.cuts import SIZE_PX, Cut
from console.planning.draft import Draft, Way
from procedures.planning.line_of_sight import SPHERE_RADIUS_MM
from procedures.strategies.trajectory import Point

CROSS, SPHERE, CHOSEN, OTHER = "#35c8ff", "#ffa64d", "#ff5fa2", "#d8a6ff"
AVOIDED = "#ff4d4d"
POINT_WITHIN_MM = 1.5  # from the image: points of a structure that are drawn in it
NEAR_MM = 3.0  # from the image: a closer end is drawn opaque, one farther off faint
GAP_PX = 9.0  # left free by the crosshair around its centre
HANDLE_PX = 9.0  # within which an end can be grasped
FONT = "bold 13px system-ui,sans-serif"
LEAST_SHARE = 0.35  # of a direction along an image's edge, to be labelled there
LETTERS = (("R", "L"), ("A", "P"), ("I", "S"))


def overlay(cut: Cut, draft: Draft, chosen: str, place_mm: Point) -> str:
    """SVG in the image's pixels."""
    parts = [*_sides(cut), *_cross(cut, place_mm)]
    parts += [_avoided(cut, np.array(one.points_mm)) for one in draft.structures]
    for number, marker in enumerate(draft.markers, start=1):
        parts += _sphere(cut, marker.centre_mm, f"{number}")
    for way in draft.ways:
        parts += _way(cut, way, CHOSEN if way.identifier == chosen else OTHER)
    return "".join(parts)


def grasped(cut: Cut, way: Way, x_px: float, y_px: float) -> str:
    """Which end of a trajectory is at a point of the image: `entry`, `target`, or neither, empty."""
    best, name = HANDLE_PX, ""
    for end, place in (("target", way.target_mm), ("entry", way.entry_mm)):
        if place is not None:
            x, y, _ = cut.to_picture(place)
            if hypot(x - x_px, y - y_px) < best:
                best, name = hypot(x - x_px, y - y_px), end
    return name


def _cross(cut: Cut, place_mm: Point) -> Iterable[str]:
    x, y, off_mm = cut.to_picture(place_mm)
    shade = 0.9 if abs(off_mm) < NEAR_MM else 0.35
    for x1, y1, x2, y2 in (
        (0.0, y, x - GAP_PX, y),
        (x + GAP_PX, y, SIZE_PX, y),
        (x, 0.0, x, y - GAP_PX),
        (x, y + GAP_PX, x, SIZE_PX),
    ):
        yield _line(x1, y1, x2, y2, CROSS, 1.0, shade)


def _sphere(cut: Cut, centre_mm: NDArray[np.float64], name: str) -> Iterable[str]:
    x, y, off_mm = cut.to_picture(centre_mm)
    if abs(off_mm) >= SPHERE_RADIUS_MM:
        return
    radius = sqrt(SPHERE_RADIUS_MM**2 - off_mm**2) / cut.step_mm
    yield _circle(x, y, radius, SPHERE, 1.6)
    yield _words(x + radius + 3, y + 4, name, SPHERE)


def _avoided(cut: Cut, points_mm: NDArray[np.float64]) -> str:
    """The points near the image, in one path: a thousand elements would not scroll."""
    away = points_mm - cut.middle_mm
    near = away[np.abs(away @ cut.normal) < POINT_WITHIN_MM]
    places = SIZE_PX / 2.0 + np.stack([near @ cut.right, near @ cut.down], axis=1) / cut.step_mm
    dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places)
    return tag("path", "", d=dots, fill="none", stroke=AVOIDED, stroke_width="4", stroke_linecap="round")


def _way(cut: Cut, way: Way, colour: str) -> Iterable[str]:
    if way.ends is not None:
        (x1, y1, _), (x2, y2, _) = (cut.to_picture(end) for end in way.ends)
        yield _line(x1, y1, x2, y2, colour, 1.6, 0.85)
    if way.entry_mm is not None:
        x, y, off_mm = cut.to_picture(way.entry_mm)
        shade = 1.0 if abs(off_mm) < NEAR_MM else 0.45
        yield (
            f'<rect x="{x - 5:.1f}" y="{y - 5:.1f}" width="10" height="10" fill="none" stroke="{colour}"'
            f' stroke-width="2" opacity="{shade}"/>'
        )
        yield _words(x + 8, y - 6, way.identifier, colour)
    if way.target_mm is not None:
        x, y, off_mm = cut.to_picture(way.target_mm)
        yield _circle(x, y, 6.0, colour, 2.0, 1.0 if abs(off_mm) < NEAR_MM else 0.45)
        yield _circle(x, y, 1.2, colour, 1.5)


def _sides(cut: Cut) -> Iterable[str]:
    half = SIZE_PX / 2.0
    for direction, x, y in (
        (cut.right, SIZE_PX - 16, half + 5),
        (-cut.right, 6, half + 5),
        (cut.down, half - 5, SIZE_PX - 7),
        (-cut.down, half - 5, 16),
    ):
        yield _words(x, y, side(direction), "#f2f2f2")


def side(direction: NDArray[np.float64]) -> str:
    """Letters of the patient's sides that a direction leads to, nearest first."""
    order = sorted(range(3), key=lambda axis: -abs(direction[axis]))
    return "".join(
        LETTERS[axis][int(direction[axis] > 0)] for axis in order if abs(direction[axis]) > LEAST_SHARE
    )


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float, shade: float) -> str:
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}"'
        f' stroke-width="{width}" opacity="{shade}"/>'
    )


def _circle(x: float, y: float, radius: float, colour: str, width: float, shade: float = 1.0) -> str:
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="none" stroke="{colour}"'
        f' stroke-width="{width}" opacity="{shade}"/>'
    )


def _words(x: float, y: float, words: str, colour: str) -> str:
    style = f"font:{FONT};paint-order:stroke;stroke:#000;stroke-width:3px"
    return tag("text", text(words), x=f"{x:.1f}", y=f"{y:.1f}", fill=colour, style=style)
